//! Shared code of the fuzz targets: a counting allocator, and the invariants of accepted scenes.

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use penumbra::internal::bvh::Bvh;
use penumbra::internal::error::Error;
use penumbra::internal::scene::{EmitterTriangle, ImportOptions, LightKind, NO_LIGHT, Scene, Triangle, Vertex};

/// Bytes in use, and their maximum.
static USED: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: forwards every call to the system allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        PEAK.fetch_max(USED.fetch_add(layout.size(), Relaxed) + layout.size(), Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        PEAK.fetch_max(USED.fetch_add(layout.size(), Relaxed) + layout.size(), Relaxed);
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        USED.fetch_sub(layout.size(), Relaxed);
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Number of bytes that a reader may use for any input: tables made once, buffers of decoders, stacks of threads.
const BASE_BYTES: usize = 16 << 20;

/// Runs a reader and checks its peak memory: at most [`BASE_BYTES`] and four times the honest size, which `honest`
/// computes from the result of the reader.
pub fn bounded<T>(read: impl FnOnce() -> T, honest: impl FnOnce(&T) -> usize) -> T {
    let before = USED.load(Relaxed);
    PEAK.store(before, Relaxed);
    let outcome = read();
    let (peak, honest) = (PEAK.load(Relaxed).saturating_sub(before), honest(&outcome));
    assert!(peak <= 4 * honest + BASE_BYTES, "{peak} bytes in use, the honest size is {honest}");
    outcome
}

/// Checks that an error is one printable line about the input.
pub fn check(error: &Error) {
    assert!(matches!(error, Error::Input { .. }), "{error:?}");
    let text = error.to_string();
    assert!(!text.contains(char::is_control) && text.len() < 2048, "{text:?}");
}

/// Imports `bytes` and checks the result. `json` is about the part of them that is JSON.
pub fn import(bytes: &[u8], json: &[u8], path: &str) {
    let lenient = bytes.len() % 2 == 1;
    let still = ImportOptions { default_light: bytes.len() % 4 < 2, lenient, ..ImportOptions::default() };
    let time = (bytes.len() % 8 < 4).then_some(bytes.len() as f64 * 0.01);
    let moved = ImportOptions { time, repeat: lenient, ..still.clone() };
    let outcome = bounded(
        || match Scene::from_bytes(bytes, Path::new(path), &moved) {
            // Without an animation there is no time.
            Err(Error::Setting { name: "time", .. }) => Scene::from_bytes(bytes, Path::new(path), &still),
            outcome => outcome,
        },
        |outcome| {
            // A JSON value takes 32 bytes of memory, and a member 32 more.
            let values = json.iter().filter(|byte| b",:[{".contains(byte)).count();
            bytes.len() + 64 * values + compressed(bytes) + outcome.as_ref().map_or(0, size)
        },
    );
    match outcome {
        Ok(scene) => check_scene(&scene),
        Err(error) => check(&error),
    }
}

/// Bytes that the compressed parts of a file can expand to, whether the import succeeds or finds a fault behind them.
fn compressed(bytes: &[u8]) -> usize {
    let count = |name: &[u8]| bytes.windows(name.len()).filter(|window| *window == name).count();
    // A block of attributes takes one byte for each four of its elements' bytes, and has 256 elements.
    let meshopt = if count(b"meshopt_compression") > 0 { 1024 * bytes.len() } else { 0 };
    // An image of one colour, at any size: 2048 x 2048 texels, or 32768 for each byte, as decoded and as converted.
    let images = if count(b"WEBP") + count(b"KTX 20") > 0 { (8 << 22).max(bytes.len() << 18) } else { 0 };
    // 256 vertices for each byte, with 512 bytes of attributes.
    let draco = if count(b"DRACO") > 0 { bytes.len() << 17 } else { 0 };
    meshopt + images + draco
}

/// The size of a scene in bytes.
fn size(scene: &Scene) -> usize {
    let emitters: usize = scene
        .lights
        .iter()
        .map(|light| match &light.kind {
            LightKind::Mesh { emitters, .. } => emitters.len(),
            _ => 0,
        })
        .sum();
    size_of_val(&*scene.vertices)
        + size_of_val(&*scene.triangles)
        + size_of_val(&*scene.materials)
        + size_of_val(&*scene.textures)
        + size_of_val(&*scene.lights)
        + size_of_val(&*scene.cameras)
        + emitters * size_of::<EmitterTriangle>()
        + scene.images.iter().map(|image| size_of_val(&*image.texels)).sum::<usize>()
}

/// Checks the properties of a scene that the renderer relies on.
fn check_scene(scene: &Scene) {
    // Enough for the scenes of a fuzzer. Hierarchies over more triangles take long.
    const MAX_TRIANGLES: usize = 10_000;
    for Vertex { position, normal, tangent, uv, colour } in scene.vertices.iter() {
        assert!(position.is_finite() && position.length() <= 1.0 + 1e-5, "{position}");
        let unit = |length: f32| length == 0.0 || (length - 1.0).abs() < 1e-5;
        assert!(unit(normal.length()) && unit(tangent.truncate().length()), "{normal} {tangent}");
        assert!(uv.iter().all(|uv| uv.is_finite()) && colour.is_finite(), "{uv:?} {colour}");
    }
    for Triangle { vertices, material, light } in &scene.triangles {
        assert!(vertices.iter().all(|v| (*v as usize) < scene.vertices.len()));
        assert!((*material as usize) < scene.materials.len());
        assert!(*light == NO_LIGHT || (*light as usize) < scene.lights.len());
    }
    for material in &scene.materials {
        assert!(material.emissive.is_finite());
        assert!(material.texture_infos().all(|info| (info.texture as usize) < scene.textures.len()));
    }
    assert!(scene.textures.iter().all(|texture| (texture.image as usize) < scene.images.len()));
    for image in scene.images.iter() {
        assert_eq!(image.texels.len(), image.width as usize * image.height as usize);
    }
    for light in &scene.lights {
        match &light.kind {
            LightKind::Mesh { emitters, .. } => assert!(emitters.iter().all(|e| e.radiance.is_finite())),
            LightKind::Point { position, intensity, .. } => assert!(position.is_finite() && intensity.is_finite()),
            LightKind::Spot { position, direction, intensity, .. } => {
                assert!(position.is_finite() && direction.is_finite() && intensity.is_finite());
            }
            LightKind::Directional { direction, irradiance } => {
                assert!(direction.is_finite() && irradiance.is_finite());
            }
            LightKind::Environment { .. } => assert!(scene.environment().is_some()),
        }
    }
    for camera in &scene.cameras {
        assert!(camera.position.is_finite() && camera.axes.iter().all(|axis| axis.is_finite()));
    }
    for note in &scene.notes {
        assert!(!note.contains(char::is_control), "{note:?}");
    }
    scene.frame_camera();
    if (1..MAX_TRIANGLES).contains(&scene.triangles.len()) {
        let positions: Vec<_> = (0..scene.triangles.len()).map(|i| scene.triangle_positions(i)).collect();
        if let Err(error) = Bvh::build(&positions) {
            panic!("{error}");
        }
    }
}

/// Also built as the test `fuzz` of the renderer, so that it compiles with every change.
#[cfg(test)]
mod tests {
    use std::fs;

    /// The invariants hold for the seeds of the fuzzer, complete and truncated.
    #[test]
    fn seeds_satisfy_the_invariants() {
        let seeds = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/seeds/scene");
        let mut imported = 0;
        for seed in fs::read_dir(seeds).unwrap() {
            let bytes = fs::read(seed.unwrap().path()).unwrap();
            for part in 1..=8 {
                let bytes = &bytes[..bytes.len() * part / 8];
                super::import(bytes, bytes, "no folder/scene.gltf");
                imported += 1;
            }
        }
        assert!(imported >= 24, "{imported}");
    }
}
