// What all functions of a scene's procedural objects share.
import package::lib::math::is_finite4;
import package::lib::constants::PROCEDURAL_ITERATIONS;

// Rays that were lost for an object: their turns were spent; a function's answer was none.
@group(1) @binding(23) var<storage, read_write> procedural_misses: array<atomic<u32>, 2>;

// Turns of loops since it was set to 0; each loop of the functions adds its own, and ends where there are too many.
var<private> procedural_iterations: u32;

const NO_CROSSING = vec4f(0.0, 0.0, 0.0, -1.0);

fn procedural_lost(answers: bool) -> vec4f {
    atomicAdd(&procedural_misses[select(0u, 1u, answers)], 1u);
    return NO_CROSSING;
}
