// Declarations that all functions of a scene's procedural objects share.
import package::lib::math::is_finite4;
import package::lib::constants::PROCEDURAL_ITERATIONS;

// Number of rays that missed an object because of an error: too many iterations; an invalid result of a function.
@group(1) @binding(23) var<storage, read_write> procedural_misses: array<atomic<u32>, 2>;

// Number of loop iterations since it was reset. Each loop of the functions counts here, and ends once there were too
// many.
var<private> procedural_iterations: u32;

const NO_CROSSING = vec4f(0.0, 0.0, 0.0, -1.0);

fn procedural_lost(invalid_result: bool) -> vec4f {
    atomicAdd(&procedural_misses[select(0u, 1u, invalid_result)], 1u);
    return NO_CROSSING;
}
