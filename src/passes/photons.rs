//! photons: rays from every light straight through the scene, and the photons they leave.

use crate::gpu::{Bindings, Buffer, Features, Gpu, Kernel, Resources};
use crate::{Error, Result, shared_struct};

use super::grid::Photon;
use super::kernel;

shared_struct! {
    /// Immediates of the pass; see `shaders/photons.wgsl`.
    pub struct PhotonParameters {
        /// The light.
        pub light: u32,
        /// First ray of the batch, of the light's rays.
        pub first_ray: u32,
        /// Rays of the batch.
        pub ray_count: u32,
        /// Seed of the render.
        pub seed: u32,
    }
}

/// Rays of one dispatch: bounds its time and the memory of the worst case, a map full of layers.
const BATCH_RAYS: u32 = 1 << 17;

/// The pass; see `shaders/photons.wgsl`.
pub struct Photons {
    kernel: Kernel,
    photons_per_ray: u32,
}

/// Photons as they were traced, in no order.
pub struct Traced {
    /// [`Photon`]s, with room for `spare` more behind them.
    pub photons: Buffer,
    /// How many.
    pub count: u32,
    /// By light: illumination and shadow photons.
    pub stored: Vec<[u32; 2]>,
}

impl Photons {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(
        gpu: &Gpu,
        features: &Features,
        constants: &[(&str, f64)],
        shadow_photons_per_ray: u32,
    ) -> Result<Photons> {
        let mut constants = constants.to_vec();
        constants.push(("shadow_photons_per_ray", f64::from(shadow_photons_per_ray)));
        let kernel = kernel(gpu, "photons", features, &constants, &["traced_photons", "photon_counts"])?;
        Ok(Photons { kernel, photons_per_ray: shadow_photons_per_ray + 1 })
    }

    /// Traces `rays` rays of each of `lights` lights. The set of photons depends on `seed` alone, their order does
    /// not matter and differs from run to run. `spare` photons more than were traced fit in the buffer.
    ///
    /// # Errors
    /// [`Error::Buffer`] where the device cannot hold the photons, [`Error::Computation`] where a ray met the loop
    /// budget, and those of [`Gpu::check`].
    pub fn trace(
        &self,
        gpu: &Gpu,
        scene: &dyn Bindings,
        lights: u32,
        rays: u32,
        seed: u32,
        spare: u32,
    ) -> Result<Traced> {
        let batch = BATCH_RAYS.min(rays.max(1));
        let room = gpu.buffer::<Photon>("penumbra/photons/traced_photons", (batch * self.photons_per_ray) as usize)?;
        let counts = gpu.buffer::<u32>("penumbra/photons/photon_counts", 4)?;
        let own = Resources::new().with("traced_photons", &room).with("photon_counts", &counts);
        let kernel = self.kernel.bind(gpu, "photons_of_light", &[&own, scene])?;
        let mut batches = Vec::new();
        let mut stored = vec![[0u32; 2]; lights as usize];
        let mut total = 0u64;
        for light in 0..lights {
            for first_ray in (0..rays).step_by(batch as usize) {
                let ray_count = batch.min(rays - first_ray);
                let mut frame = gpu.frame("photons");
                frame.clear(&counts);
                frame.run(&kernel, ray_count, &PhotonParameters { light, first_ray, ray_count, seed });
                frame.submit()?;
                let [count, illumination, overrun, _]: [u32; 4] = gpu.read::<[u32; 4]>(&counts, 1)?[0];
                if overrun > 0 {
                    return Err(Error::Computation {
                        kernel: "photons".to_owned(),
                        problem: format!(
                            "{overrun} photon rays met more geometry than the device's loop budget allows"
                        ),
                    });
                }
                stored[light as usize][0] += illumination;
                stored[light as usize][1] += count - illumination;
                total += u64::from(count);
                // Batches wait in buffers of their own until it is known how many photons there are in all.
                let kept = gpu.buffer::<Photon>("penumbra/photons/batch", count as usize)?;
                let mut frame = gpu.frame("photons");
                frame.copy(&room, &kept, 0, u64::from(count) * size_of::<Photon>() as u64);
                frame.submit()?;
                batches.push((kept, count));
            }
        }
        let photons = gpu.buffer::<Photon>("penumbra/photons/photons", total as usize + spare as usize)?;
        let mut frame = gpu.frame("photons");
        let mut at = 0;
        for (kept, count) in &batches {
            let bytes = u64::from(*count) * size_of::<Photon>() as u64;
            frame.copy(kept, &photons, at, bytes);
            at += bytes;
        }
        frame.submit()?;
        Ok(Traced { photons, count: total as u32, stored })
    }
}
