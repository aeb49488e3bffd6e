//! Pass `flux`: traces the photons that carry flux, for the global map and the caustic map. Each light emits rays in
//! proportion to its power. A ray stores a photon at every diffuse surface that it hits; Russian roulette by the BSDF
//! ends it.

use kernel_kit::{Bindings, Buffer, Gpu, Kernel, bindings, shared_struct};

use super::grid::PhotonBuffer;
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
const DISPATCH_RAYS: u32 = 1 << 15;

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
    /// [`Photon`](super::grid::Photon)s.
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
    pub clipped: u64,
    /// Photons not stored because their flux is not finite.
    pub not_finite: u64,
    /// Rays that exceeded the loop budget. Their later photons are missing.
    pub overruns: u64,
}

/// A trace under way: its buffers, and the photons so far.
struct FluxTrace<'a> {
    gpu: &'a Gpu,
    settings: FluxSettings,
    light_count: u32,
    /// Rays from all lights together.
    emitted: u32,
    /// Largest flux of a ray that leaves a light: the unit of flux in the photons' words.
    unit: f64,
    ray_table: Buffer,
    counts: Buffer,
    photons: PhotonBuffer,
}

/// The kernel's counts, by the indices `FLUX_STORED` and so on.
type FluxCounts = [u32; FLUX_COUNTS as usize];

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
            if let Some(photons) = FluxTrace::new(gpu, &powers, settings)?.run(&self.0, scene)? {
                return Ok(photons);
            }
            settings.rays /= 2;
        }
    }
}

impl<'a> FluxTrace<'a> {
    fn new(gpu: &'a Gpu, powers: &[f64], settings: FluxSettings) -> Result<FluxTrace<'a>> {
        let first_rays = first_rays(powers, settings.rays);
        let emitted = first_rays[powers.len()];
        let by_light = powers.iter().zip(first_rays.windows(2)).filter(|(_, ends)| ends[1] > ends[0]);
        let unit = by_light.map(|(power, ends)| power / f64::from(ends[1] - ends[0])).fold(0.0, f64::max);
        Ok(FluxTrace {
            gpu,
            settings,
            light_count: powers.len() as u32,
            emitted,
            unit,
            ray_table: gpu.upload("penumbra/flux/rays", &first_rays)?,
            counts: gpu.buffer::<u32>("penumbra/flux/counts", FLUX_COUNTS as usize)?,
            photons: PhotonBuffer::new(gpu, "penumbra/flux/photons", PHOTONS_PER_RAY * emitted as usize)?,
        })
    }

    /// All photons, or `None` if they would outgrow the device's largest binding.
    fn run(mut self, kernel: &Kernel, scene: &dyn Bindings) -> Result<Option<FluxPhotons>> {
        let mut sums = [0u64; FLUX_COUNTS as usize];
        let mut first_ray = 0;
        while first_ray < self.emitted && self.unit > 0.0 {
            let ray_count = DISPATCH_RAYS.min(self.emitted - first_ray);
            let counts = self.dispatch(kernel, scene, first_ray, ray_count)?;
            let needed = self.photons.count + counts[FLUX_STORED as usize] as usize;
            if needed > self.photons.room {
                if !self.photons.reserve(self.gpu, needed)? {
                    return Ok(None);
                }
                // The same rays again, because which of their photons fitted is not deterministic.
                continue;
            }
            self.photons.count = needed;
            sums.iter_mut().zip(counts).for_each(|(sum, more)| *sum += u64::from(more));
            first_ray += ray_count;
        }
        let sum = |count: u32| sums[count as usize];
        Ok(Some(FluxPhotons {
            photons: self.photons.buffer,
            count: self.photons.count as u32,
            emitted: self.emitted,
            rays: sum(FLUX_TRACED),
            step: self.unit / f64::from(FLUX_STEPS),
            clipped: sum(FLUX_CLIPPED),
            not_finite: sum(FLUX_NOT_FINITE),
            overruns: sum(FLUX_OVERRUNS),
        }))
    }

    /// Traces some of the rays. The kernel appends their photons to those of earlier rays, as far as there is room, and
    /// counts all.
    fn dispatch(&self, kernel: &Kernel, scene: &dyn Bindings, first_ray: u32, ray_count: u32) -> Result<FluxCounts> {
        let FluxTrace { gpu, settings, photons, counts, ray_table, .. } = self;
        let own = FluxBindings { flux_photons: &photons.buffer, flux_counts: counts, flux_rays: ray_table };
        let bound = kernel.bind(gpu, "flux", &[&own, scene])?;
        let parameters = FluxParameters {
            first_ray,
            ray_count,
            light_count: self.light_count,
            seed: settings.seed,
            max_bounces: settings.max_bounces,
            stored: photons.count as u32,
            inverse_unit: (1.0 / self.unit) as f32,
            caustics_only: u32::from(settings.caustics_only),
        };
        let mut frame = gpu.frame("flux");
        frame.clear(counts);
        frame.run(&bound, ray_count, &parameters);
        frame.submit()?;
        Ok(gpu.read::<FluxCounts>(counts, 1)?[0])
    }
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
