//! photons: rays from the lights through everything they meet; what they leave is the visibility map's photons.

use crate::gpu::{Bindings, Buffer, Features, Gpu, Kernel};
use crate::{Error, Result, bindings, shared_struct};

use super::grid::{MAX_LIGHTS, Photon};
use super::kernel;

shared_struct! {
    /// Immediates of the pass; see `shaders/photons.wgsl`.
    pub struct PhotonParameters {
        first_ray: u32,
        ray_count: u32,
        first_light: u32,
        light_count: u32,
        seed: u32,
        padding: u32,
    }
}

bindings! {
    /// What the kernel writes.
    struct PhotonBindings { traced_photons, traced_counts }
}

/// Rays of a dispatch: some tens of milliseconds on a software device, and no danger to a desktop's watchdog.
const BATCH_RAYS: u32 = 1 << 16;

/// Most shadow photons that may be kept of one ray, as the kernel has it.
pub const MAX_SHADOW_PHOTONS_PER_RAY: u32 = 64;

/// The counts' words before those of the lights, as the kernel has them.
const COUNT_HEADER: usize = 2;

/// The pass; see `shaders/photons.wgsl`.
pub struct Photons {
    kernel: Kernel,
    shadow_photons_per_ray: u32,
}

/// Whose photons, and how many.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PhotonRequest {
    /// First light of the map.
    pub first_light: u32,
    /// Lights in it, 1 to [`MAX_LIGHTS`].
    pub lights: u32,
    /// Photons emitted from each light.
    pub per_light: u32,
    /// Seed of the render.
    pub seed: u32,
}

/// Photons on the device, in any order; their set depends on nothing but the scene, the request and the settings.
pub struct TracedPhotons {
    /// [`Photon`]s; the buffer may have room for more.
    pub photons: Buffer,
    /// How many.
    pub count: u32,
    /// Emitted from each light: fewer than asked for where no more fit into one binding of the device.
    pub emitted: Vec<u32>,
    /// Illumination and shadow photons stored, of each light.
    pub stored: Vec<[u32; 2]>,
}

impl Photons {
    /// Compiles the kernel. At most `shadow_photons_per_ray` shadow photons are kept of one ray.
    ///
    /// # Errors
    /// As [`Kernel::new`]; [`Error::Usage`] for a number out of 1 to [`MAX_SHADOW_PHOTONS_PER_RAY`].
    pub fn new(
        gpu: &Gpu,
        features: &Features,
        constants: &[(&str, f64)],
        shadow_photons_per_ray: u32,
    ) -> Result<Photons> {
        if !(1..=MAX_SHADOW_PHOTONS_PER_RAY).contains(&shadow_photons_per_ray) {
            return Err(Error::Usage(format!(
                "--shadow-photons-per-ray {shadow_photons_per_ray}: it must be between 1 and \
                 {MAX_SHADOW_PHOTONS_PER_RAY}"
            )));
        }
        let mut constants = constants.to_vec();
        constants.push(("shadow_photons_per_ray", f64::from(shadow_photons_per_ray)));
        let kernel = kernel(gpu, "photons", features, &constants, PhotonBindings::NAMES)?;
        Ok(Photons { kernel, shadow_photons_per_ray })
    }

    /// Traces the photons, batch by batch; the buffer grows as they need, up to what the device can bind.
    ///
    /// # Errors
    /// [`Error::Usage`] for lights out of range, [`Error::Computation`] where a traversal gave up, else as
    /// [`Gpu::check`] and [`Kernel::bind`].
    pub fn trace(&self, gpu: &Gpu, scene: &dyn Bindings, request: &PhotonRequest) -> Result<TracedPhotons> {
        if !(1..=MAX_LIGHTS).contains(&request.lights) {
            return Err(Error::Usage(format!("a photon map is for 1 to {MAX_LIGHTS} lights, not {}", request.lights)));
        }
        let lights = request.lights as usize;
        let rays = u64::from(request.per_light) * u64::from(request.lights);
        if rays > u64::from(u32::MAX) {
            return Err(Error::Usage(format!("--photons {}: 2^32 or more of all lights together", request.per_light)));
        }
        let rays = rays as u32;
        let batch_rays = BATCH_RAYS.min(rays.max(1));
        let batch_photons = (batch_rays * (1 + self.shadow_photons_per_ray)) as usize;
        let batch = gpu.buffer::<Photon>("penumbra/photons/batch", batch_photons)?;
        let counts = gpu.buffer::<u32>("penumbra/photons/counts", COUNT_HEADER + 2 * lights)?;
        let own = PhotonBindings { traced_photons: &batch, traced_counts: &counts };
        let bound = self.kernel.bind(gpu, "photons", &[&own, scene])?;
        let limit = (gpu.max_buffer_bytes() / size_of::<Photon>() as u64) as usize;

        let mut photons = gpu.buffer::<Photon>("penumbra/photons/photons", (rays as usize * 2).min(limit))?;
        let mut room = (photons.bytes / size_of::<Photon>() as u64) as usize;
        let (mut count, mut done) = (0, 0);
        let mut stored = vec![[0; 2]; lights];
        while done < rays {
            let ray_count = batch_rays.min(rays - done);
            let parameters = PhotonParameters {
                first_ray: done,
                ray_count,
                first_light: request.first_light,
                light_count: request.lights,
                seed: request.seed,
                padding: 0,
            };
            let mut frame = gpu.frame("photons");
            frame.clear(&counts);
            frame.run(&bound, ray_count, &parameters);
            frame.submit()?;
            let counted: Vec<u32> = gpu.read(&counts, COUNT_HEADER + 2 * lights)?;
            if counted[1] > 0 {
                return Err(Error::Computation {
                    kernel: "photons".to_owned(),
                    problem: format!("{} rays met more triangles than one invocation may", counted[1]),
                });
            }
            let more = counted[0] as usize;
            if count + more > limit {
                break;
            }
            let mut frame = gpu.frame("photons");
            if count + more > room {
                room = (2 * room).max(count + more).min(limit);
                let larger = gpu.buffer::<Photon>("penumbra/photons/photons", room)?;
                copy(&mut frame, &photons, &larger, 0, count);
                photons = larger;
            }
            copy(&mut frame, &batch, &photons, count, more);
            frame.submit()?;
            count += more;
            done += ray_count;
            for (sum, new) in stored.iter_mut().zip(counted[COUNT_HEADER..].chunks_exact(2)) {
                *sum = [sum[0] + new[0], sum[1] + new[1]];
            }
        }
        // Rays are numbered round by round of the lights.
        let emitted = (0..request.lights).map(|light| done / request.lights + u32::from(light < done % request.lights));
        Ok(TracedPhotons { photons, count: count as u32, emitted: emitted.collect(), stored })
    }
}

/// Copies the first `count` photons of one buffer behind the first `at` of another.
fn copy(frame: &mut crate::gpu::Frame<'_>, from: &Buffer, to: &Buffer, at: usize, count: usize) {
    let bytes = |photons: usize| (photons * size_of::<Photon>()) as u64;
    if count > 0 {
        frame.encoder.copy_buffer_to_buffer(&from.raw, 0, &to.raw, bytes(at), bytes(count));
    }
}
