//! Pass `flux`: traces the photons that carry flux, for the global map and the caustic map. Each light emits rays in
//! proportion to its power. A ray stores a photon at every diffuse surface that it hits; Russian roulette by the BSDF
//! ends it.

use kernel_kit::{Bindings, Buffer, Gpu, Kernel, bindings, shared_struct};

use super::grid::Photon;
use super::kernel;
use crate::Result;
use crate::gpu_scene::GpuLights;
use crate::kernels::{FLUX_CLIPPED, FLUX_COUNTS, FLUX_NOT_FINITE, FLUX_OVERRUNS, FLUX_STEPS, FLUX_STORED, FLUX_TRACED};
use crate::specialisation::features::Features;

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
        caustics_only: u32,
    }
}

bindings! {
    /// Everything that the kernel reads and writes except the scene.
    struct FluxBindings {
        pub flux_photons: &Buffer,
        pub flux_counts: &Buffer,
        pub flux_rays: &Buffer,
    }
}

/// Rays in a dispatch. It takes some tens of milliseconds on a software device, too short for a desktop's watchdog to
/// stop it.
const BATCH_RAYS: u32 = 1 << 15;

/// Photons per ray that the first buffer has room for. In a room of albedo 0.7 a ray stores 3 on average.
const PHOTONS_PER_RAY: usize = 4;

/// The pass; see `shaders/flux.wgsl`.
pub struct Flux(Kernel);

/// How many photons to trace, and how far.
#[derive(Clone, Copy, Debug)]
pub struct FluxSettings {
    /// Rays from all lights together, distributed by power; each light that emits has at least one.
    pub rays: u32,
    /// Maximum number of bounces before a photon is stored.
    pub max_bounces: u32,
    /// Seed of the random numbers.
    pub seed: u32,
    /// Only photons that focusing surfaces alone have reflected or transmitted are stored, for the caustic map. The
    /// kernel needs the feature `caustics` for it.
    pub caustics_only: bool,
}

/// Photons on the device, in any order. Their set depends only on the scene, the settings and the seed.
pub struct FluxPhotons {
    /// [`Photon`]s.
    pub photons: Buffer,
    /// Number of photons.
    pub count: u32,
    /// Rays emitted: fewer than requested where the photons would not fit into one binding of the device.
    pub emitted: u32,
    /// Rays traced, those from surfaces included.
    pub rays: u64,
    /// Power of one step of a photon's encoded flux, in the scene's units over normalised lengths squared.
    pub step: f64,
    /// Photons whose flux exceeded [`MAX_FLUX`](crate::kernels::MAX_FLUX) units and was clipped to it.
    pub cut: u64,
    /// Photons not stored because their flux is not finite.
    pub not_finite: u64,
    /// Rays that exceeded the loop budget. Their later photons are missing.
    pub overruns: u64,
}

/// The batches of a trace: its buffers and what they hold so far.
struct Batches<'a> {
    gpu: &'a Gpu,
    settings: FluxSettings,
    light_count: u32,
    /// Largest flux of a ray that leaves a light: the unit of flux in the photons' words.
    unit: f64,
    ray_table: Buffer,
    counts: Buffer,
    /// Photons that `traced.photons` has room for, and the maximum that one binding of the device holds.
    room: usize,
    limit: usize,
    traced: FluxPhotons,
}

impl Flux {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Flux> {
        Ok(Flux(kernel(gpu, "flux", features, constants, &[FluxBindings::DECLARED])?))
    }

    /// Traces photons from all lights. If they would outgrow the device's largest binding, starts again with half as
    /// many rays.
    ///
    /// # Errors
    /// As [`Gpu::check`] and [`Kernel::bind`].
    pub fn trace(
        &self,
        gpu: &Gpu,
        scene: &dyn Bindings,
        lights: &GpuLights,
        mut settings: FluxSettings,
    ) -> Result<FluxPhotons> {
        let powers: Vec<f64> = lights.lights.iter().map(|light| light.received_share * light.power).collect();
        loop {
            if let Some(photons) = Batches::new(gpu, &powers, settings)?.trace(&self.0, scene)? {
                return Ok(photons);
            }
            settings.rays /= 2;
        }
    }
}

impl<'a> Batches<'a> {
    fn new(gpu: &'a Gpu, powers: &[f64], settings: FluxSettings) -> Result<Batches<'a>> {
        let first_rays = first_rays(powers, settings.rays);
        let emitted = first_rays[powers.len()];
        let by_light = powers.iter().zip(first_rays.windows(2)).filter(|(_, ends)| ends[1] > ends[0]);
        let unit = by_light.map(|(power, ends)| power / f64::from(ends[1] - ends[0])).fold(0.0, f64::max);
        let limit = (gpu.max_buffer_bytes() / size_of::<Photon>() as u64) as usize;
        let room = (PHOTONS_PER_RAY * emitted as usize).clamp(1, limit);
        let traced = FluxPhotons {
            photons: photon_buffer(gpu, room)?,
            count: 0,
            emitted,
            rays: 0,
            step: unit / f64::from(FLUX_STEPS),
            cut: 0,
            not_finite: 0,
            overruns: 0,
        };
        Ok(Batches {
            gpu,
            settings,
            light_count: powers.len() as u32,
            unit,
            ray_table: gpu.upload("penumbra/flux/rays", &first_rays)?,
            counts: gpu.buffer::<u32>("penumbra/flux/counts", FLUX_COUNTS as usize)?,
            room,
            limit,
            traced,
        })
    }

    /// All photons, or `None` if they would outgrow the device's largest binding.
    fn trace(mut self, kernel: &Kernel, scene: &dyn Bindings) -> Result<Option<FluxPhotons>> {
        let mut first_ray = 0;
        while first_ray < self.traced.emitted && self.unit > 0.0 {
            let ray_count = BATCH_RAYS.min(self.traced.emitted - first_ray);
            let counts = self.run(kernel, scene, first_ray, ray_count)?;
            let needed = self.traced.count as usize + counts[FLUX_STORED as usize] as usize;
            if needed > self.limit {
                return Ok(None);
            }
            if needed > self.room {
                // Traces the batch again, because which of its photons fitted is not deterministic.
                self.grow(needed)?;
                continue;
            }
            self.traced.count += counts[FLUX_STORED as usize];
            self.traced.rays += u64::from(counts[FLUX_TRACED as usize]);
            self.traced.cut += u64::from(counts[FLUX_CLIPPED as usize]);
            self.traced.not_finite += u64::from(counts[FLUX_NOT_FINITE as usize]);
            self.traced.overruns += u64::from(counts[FLUX_OVERRUNS as usize]);
            first_ray += ray_count;
        }
        Ok(Some(self.traced))
    }

    /// Traces one batch and appends its photons to those of earlier batches. Returns the kernel's counts.
    fn run(
        &self,
        kernel: &Kernel,
        scene: &dyn Bindings,
        first_ray: u32,
        ray_count: u32,
    ) -> Result<[u32; FLUX_COUNTS as usize]> {
        let own =
            FluxBindings { flux_photons: &self.traced.photons, flux_counts: &self.counts, flux_rays: &self.ray_table };
        let bound = kernel.bind(self.gpu, "flux", &[&own, scene])?;
        let parameters = FluxParameters {
            first_ray,
            ray_count,
            light_count: self.light_count,
            seed: self.settings.seed,
            max_bounces: self.settings.max_bounces,
            stored: self.traced.count,
            inverse_unit: (1.0 / self.unit) as f32,
            caustics_only: u32::from(self.settings.caustics_only),
        };
        let mut frame = self.gpu.frame("flux");
        frame.clear(&self.counts);
        frame.run(&bound, ray_count, &parameters);
        frame.submit()?;
        Ok(self.gpu.read::<[u32; FLUX_COUNTS as usize]>(&self.counts, 1)?[0])
    }

    /// Moves the photons to a buffer with room for `needed` photons.
    fn grow(&mut self, needed: usize) -> Result<()> {
        self.room = (2 * self.room).max(needed).min(self.limit);
        let larger = photon_buffer(self.gpu, self.room)?;
        let mut frame = self.gpu.frame("flux");
        let bytes = u64::from(self.traced.count) * size_of::<Photon>() as u64;
        frame.copy(&self.traced.photons, &larger, 0, bytes);
        frame.submit()?;
        self.traced.photons = larger;
        Ok(())
    }
}

fn photon_buffer(gpu: &Gpu, room: usize) -> Result<Buffer> {
    Ok(gpu.buffer::<Photon>("penumbra/flux/photons", room)?)
}

/// Index of the first ray of each light, and the total at the end. The rays are distributed by power; each light that
/// emits has at least one.
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
