//! Pass `photons`: traces rays from the lights, straight on through every surface, and stores the photons of the
//! visibility map at the hits (figure 1 of the paper).

use kernel_kit::{Bindings, Buffer, Gpu, Kernel, bindings, shared_struct};

use super::grid::{Photon, PhotonBuffer, check_lights};
use super::kernel;
use crate::kernels::{PHOTON_COUNT_HEADER, PHOTON_COUNTS_PER_LIGHT};
use crate::settings::Settings;
use crate::specialisation::features::Features;
use crate::{Error, Result};

shared_struct! {
    /// Immediates of the pass; see `shaders/photons.wgsl`.
    pub struct PhotonParameters {
        first_ray: u32,
        ray_count: u32,
        light_count: u32,
        seed: u32,
    }
}

bindings! {
    /// The output of the kernel.
    struct PhotonBindings {
        pub traced_photons: &Buffer,
        pub traced_counts: &Buffer,
    }
}

/// Maximum number of rays in a dispatch. It takes some tens of milliseconds on a software device, too short for a
/// desktop's watchdog to stop it.
const DISPATCH_RAYS: u32 = 1 << 16;

/// Photons per ray that the first buffer has room for: the illumination photon and one shadow photon, as in a closed
/// room with few objects.
const PHOTONS_PER_RAY: usize = 2;

/// The pass; see `shaders/photons.wgsl`.
pub struct Photons {
    kernel: Kernel,
    shadow_photons_per_ray: u32,
}

/// Photons on the device, in any order; their set depends on nothing but the scene, the settings and the seed.
pub struct Traced {
    /// [`Photon`]s, with the spare room that [`Photons::trace`] was given.
    pub photons: Buffer,
    /// Number of photons.
    pub count: u32,
    /// Rays emitted by each light: fewer than requested where more photons would not fit into one binding of the
    /// device.
    pub emitted: Vec<u32>,
    /// Illumination and shadow photons stored, of each light.
    pub stored: Vec<[u32; 2]>,
    /// Rays that exceeded the loop budget, and stored no photon.
    pub overruns: u64,
}

impl Photons {
    /// Compiles the kernel, which stores at most `shadow_photons_per_ray` shadow photons per ray.
    ///
    /// # Errors
    /// As [`Kernel::new`]; [`Error::Setting`] for a number out of 1 to [`Settings::MAX_SHADOW_PHOTONS`].
    pub fn new(
        gpu: &Gpu,
        features: &Features,
        constants: &[(&str, f64)],
        shadow_photons_per_ray: u32,
    ) -> Result<Photons> {
        let max = Settings::MAX_SHADOW_PHOTONS;
        if !(1..=max).contains(&shadow_photons_per_ray) {
            let problem = format!("is {shadow_photons_per_ray}; it must be from 1 to {max}");
            return Err(Error::setting("visibility_map.shadow_photons_per_ray", problem));
        }
        let mut constants = constants.to_vec();
        constants.push(("shadow_photons_per_ray", f64::from(shadow_photons_per_ray)));
        let kernel = kernel(gpu, "photons", features, &constants, &[PhotonBindings::DECLARED])?;
        Ok(Photons { kernel, shadow_photons_per_ray })
    }

    /// Traces `rays` rays from each of `lights` lights, some in each dispatch. The buffer grows with the photons, up to
    /// the largest that the device can bind. Tracing stops when they no longer fit; the numbers of rays of any two
    /// lights then differ by at most one. The buffer keeps room for `spare` further photons.
    ///
    /// # Errors
    /// [`Error::Usage`] for lights and [`Error::Setting`] for rays out of range, else as [`Gpu::check`] and
    /// [`Kernel::bind`].
    pub fn trace(
        &self,
        gpu: &Gpu,
        scene: &dyn Bindings,
        lights: u32,
        rays: u32,
        seed: u32,
        spare: u32,
    ) -> Result<Traced> {
        check_lights(lights)?;
        let all_rays = rays_of_all_lights(rays, lights)?;
        let max_rays = DISPATCH_RAYS.min(all_rays.max(1));
        let max_photons = (max_rays * (1 + self.shadow_photons_per_ray)) as usize;
        let traced = gpu.buffer::<Photon>("penumbra/photons/traced", max_photons)?;
        let words = (PHOTON_COUNT_HEADER + PHOTON_COUNTS_PER_LIGHT * lights) as usize;
        let counts = gpu.buffer::<u32>("penumbra/photons/counts", words)?;
        let own = PhotonBindings { traced_photons: &traced, traced_counts: &counts };
        let bound = self.kernel.bind(gpu, "photons", &[&own, scene])?;

        let spare = spare as usize;
        let expected = PHOTONS_PER_RAY * all_rays as usize;
        let mut photons = PhotonBuffer::new(gpu, "penumbra/photons/photons", expected + spare)?;
        let (mut done, mut overruns) = (0, 0);
        let mut stored = vec![[0; 2]; lights as usize];
        while done < all_rays {
            let ray_count = max_rays.min(all_rays - done);
            let mut frame = gpu.frame("photons");
            frame.clear(&counts);
            frame.run(&bound, ray_count, &PhotonParameters { first_ray: done, ray_count, light_count: lights, seed });
            frame.submit()?;
            let counted = Counted::read(gpu, &counts)?;
            if !photons.append(gpu, &traced, counted.photons, spare)? {
                break;
            }
            done += ray_count;
            overruns += counted.overruns;
            for (sum, new) in stored.iter_mut().zip(counted.stored) {
                *sum = [sum[0] + new[0], sum[1] + new[1]];
            }
        }
        // Ray numbers go round the lights, one ray of each light per round.
        let emitted = (0..lights).map(|light| done / lights + u32::from(light < done % lights)).collect();
        Ok(Traced { photons: photons.buffer, count: photons.count as u32, emitted, stored, overruns })
    }
}

/// Rays of all lights together, for `rays` rays of each.
///
/// # Errors
/// [`Error::Setting`] if a 32-bit number cannot count them.
fn rays_of_all_lights(rays: u32, lights: u32) -> Result<u32> {
    u32::try_from(u64::from(rays) * u64::from(lights)).map_err(|_| {
        let problem = format!("is {rays}: all lights together would emit 2^32 photons or more");
        Error::setting("visibility_map.photons_per_light", problem)
    })
}

/// What a dispatch counted.
struct Counted {
    photons: usize,
    /// Rays that exceeded the loop budget.
    overruns: u64,
    /// Illumination and shadow photons of each light.
    stored: Vec<[u32; 2]>,
}

impl Counted {
    fn read(gpu: &Gpu, counts: &Buffer) -> Result<Counted> {
        let words: Vec<u32> = gpu.read(counts, counts.bytes as usize / size_of::<u32>())?;
        let by_light = words[PHOTON_COUNT_HEADER as usize..].chunks_exact(PHOTON_COUNTS_PER_LIGHT as usize);
        let stored = by_light.map(|light| [light[0], light[1]]).collect();
        Ok(Counted { photons: words[0] as usize, overruns: u64::from(words[1]), stored })
    }
}
