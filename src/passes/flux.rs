//! Pass `flux`: photons that carry flux, the global map: rays from the lights by their power, stored at every diffuse
//! surface, going on by Russian roulette on the BSDF.

use crate::gpu::{Bindings, Buffer, Features, Gpu, Kernel};
use crate::gpu_scene::GpuLights;
use crate::{Result, bindings, shared_struct};

use super::grid::Photon;
use super::kernel;

shared_struct! {
    /// Immediates of the pass; see `shaders/flux.wgsl`.
    pub struct FluxParameters {
        first_ray: u32,
        ray_count: u32,
        light_count: u32,
        seed: u32,
        max_bounces: u32,
        stored: u32,
        inverse_unit: f32,
        padding: u32,
    }
}

bindings! {
    /// What the kernel reads and writes beside the scene.
    struct FluxBindings { flux_photons, flux_counts, flux_rays }
}

/// Rays of a dispatch: some tens of milliseconds on a software device, and no danger to a desktop's watchdog.
const BATCH_RAYS: u32 = 1 << 15;

/// Photons that are made room for at first, by ray: a room of albedo 0.7 stores 3.
const PHOTONS_PER_RAY: usize = 4;

/// Steps of a photon's word to a unit of flux, as the kernels have it.
const FLUX_STEPS: f64 = 31.0;

/// The pass; see `shaders/flux.wgsl`.
pub struct Flux(Kernel);

/// Photons on the device, in any order; their set depends on nothing but the scene, the settings and the seed.
pub struct FluxPhotons {
    /// [`Photon`]s.
    pub photons: Buffer,
    /// How many.
    pub count: u32,
    /// Rays that left the lights: fewer than asked for where the photons of more do not fit into one binding of the device.
    pub emitted: u32,
    /// Rays traced, from surfaces too.
    pub rays: u64,
    /// Power of one step of a photon's word, in the scene's units over normalised lengths squared.
    pub step: f64,
    /// Photons that carry more than their word holds, and lost the rest.
    pub cut: u64,
    /// Photons that were not stored, as what they carry is not finite.
    pub not_finite: u64,
    /// Rays that met the loop budget: their photons from there on are missing.
    pub overruns: u64,
}

impl Flux {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Flux> {
        Self::with_caustic_photons(gpu, features, constants, false)
    }

    /// As [`Flux::new`], for the photons of the caustic map: those that focusing surfaces alone have sent on.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn of_caustics(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Flux> {
        Self::with_caustic_photons(gpu, features, constants, true)
    }

    fn with_caustic_photons(gpu: &Gpu, features: &Features, constants: &[(&str, f64)], on: bool) -> Result<Flux> {
        let mut constants = constants.to_vec();
        constants.push(("caustic_photons", f64::from(u8::from(on))));
        Ok(Flux(kernel(gpu, "flux", features, &constants, FluxBindings::NAMES)?))
    }

    /// Traces `rays` rays from all lights together, by their power, each light at least one. Photons are stored after at
    /// most `max_bounces` bounces. Where they outgrow the device's largest binding, half as many rays are traced in
    /// their stead.
    ///
    /// # Errors
    /// As [`Gpu::check`] and [`Kernel::bind`].
    pub fn trace(
        &self,
        gpu: &Gpu,
        scene: &dyn Bindings,
        lights: &GpuLights,
        mut rays: u32,
        max_bounces: u32,
        seed: u32,
    ) -> Result<FluxPhotons> {
        loop {
            if let Some(photons) = self.try_trace(gpu, scene, lights, rays, max_bounces, seed)? {
                return Ok(photons);
            }
            rays /= 2;
        }
    }

    fn try_trace(
        &self,
        gpu: &Gpu,
        scene: &dyn Bindings,
        lights: &GpuLights,
        rays: u32,
        max_bounces: u32,
        seed: u32,
    ) -> Result<Option<FluxPhotons>> {
        let powers: Vec<f64> = lights.lights.iter().map(|light| light.received_share * light.power).collect();
        let first_rays = first_rays(&powers, rays);
        let emitted = first_rays[powers.len()];
        let by_light = powers.iter().zip(first_rays.windows(2)).filter(|(_, ends)| ends[1] > ends[0]);
        let unit = by_light.map(|(power, ends)| power / f64::from(ends[1] - ends[0])).fold(0.0, f64::max);
        let ray_table = gpu.upload("penumbra/flux/rays", &first_rays)?;
        let counts = gpu.buffer::<u32>("penumbra/flux/counts", 5)?;
        let limit = (gpu.max_buffer_bytes() / size_of::<Photon>() as u64) as usize;
        let mut room = (PHOTONS_PER_RAY * emitted as usize).clamp(1, limit);
        let new_buffer = |room| gpu.buffer::<Photon>("penumbra/flux/photons", room);
        let mut photons = new_buffer(room)?;
        let mut traced = FluxPhotons {
            photons: new_buffer(0)?,
            count: 0,
            emitted,
            rays: 0,
            step: unit / FLUX_STEPS,
            cut: 0,
            not_finite: 0,
            overruns: 0,
        };
        let mut done = 0;
        while done < emitted && unit > 0.0 {
            let own = FluxBindings { flux_photons: &photons, flux_counts: &counts, flux_rays: &ray_table };
            let bound = self.0.bind(gpu, "flux", &[&own, scene])?;
            let ray_count = BATCH_RAYS.min(emitted - done);
            let parameters = FluxParameters {
                first_ray: done,
                ray_count,
                light_count: powers.len() as u32,
                seed,
                max_bounces,
                stored: traced.count,
                inverse_unit: (1.0 / unit) as f32,
                padding: 0,
            };
            let mut frame = gpu.frame("flux");
            frame.clear(&counts);
            frame.run(&bound, ray_count, &parameters);
            frame.submit()?;
            let [more, overruns, rays, cut, not_finite]: [u32; 5] = gpu.read::<[u32; 5]>(&counts, 1)?[0];
            let needed = traced.count as usize + more as usize;
            if needed > limit {
                return Ok(None);
            }
            if needed > room {
                // The batch is traced again: which of its photons found room depends on chance.
                room = (2 * room).max(needed).min(limit);
                let larger = new_buffer(room)?;
                let mut frame = gpu.frame("flux");
                frame.copy(&photons, &larger, 0, u64::from(traced.count) * size_of::<Photon>() as u64);
                frame.submit()?;
                photons = larger;
                continue;
            }
            traced.count += more;
            traced.rays += u64::from(rays);
            traced.cut += u64::from(cut);
            traced.not_finite += u64::from(not_finite);
            traced.overruns += u64::from(overruns);
            done += ray_count;
        }
        Ok(Some(FluxPhotons { photons, ..traced }))
    }
}

/// The first ray of each light, and the end: `rays` of them by power, at least one of each light that has some.
fn first_rays(powers: &[f64], rays: u32) -> Vec<u32> {
    let total: f64 = powers.iter().sum();
    let mut first = vec![0];
    let mut end = 0;
    for power in powers {
        if *power > 0.0 {
            end += ((f64::from(rays) * power / total).round() as u32).max(1);
        }
        first.push(end);
    }
    first
}
