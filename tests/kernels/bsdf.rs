//! The BSDF against glTF's formulas in f64, reciprocity, energy, and its sampler against its density.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::sync::{Arc, LazyLock, Mutex, OnceLock};

use glam::{DQuat, DVec2, DVec3};
use kernel_kit::{Buffer, Gpu, Kernel, Resources, kernel_test};
use penumbra::internal::gpu_scene::{sheen, sobol};
use penumbra::internal::kernels::compose_source;
use penumbra::internal::specialisation::features::{Feature, Features};

use crate::kit::{device_features, new_kernel};
use crate::random::{Random, RandomInput as _};
use crate::statistics::chi_square;

/// A surface of one colour, as the kernel gets it.
#[derive(Clone, Copy, Debug)]
struct Tested {
    base: f64,
    roughness: f64,
    metallic: f64,
    view: DVec3,
    /// Angle of the geometric normal to the shading normal, which is +z, in the xz plane.
    tilt: f64,
    glossy: bool,
    lobes: Lobes,
}

/// The lobes of extensions of glTF.
#[derive(Clone, Copy, Debug)]
struct Lobes {
    /// Share of the base that transmits light.
    transmission: f64,
    /// Index of refraction on the viewer's side over that on the other; 1: a thin wall.
    eta: f64,
    /// Share of the rest of the base that transmits light diffusely.
    diffused: f64,
    coat: f64,
    coat_roughness: f64,
    /// Angle of the coat's normal to the base's, in the xz plane.
    coat_tilt: f64,
    /// Roughness along the tangent +x; `None`: the same as across.
    along: Option<f64>,
    sheen: f64,
    sheen_roughness: f64,
    film: Option<Film>,
}

const NO_LOBES: Lobes = Lobes {
    transmission: 0.0,
    eta: 1.0,
    diffused: 0.0,
    coat: 0.0,
    coat_roughness: 0.0,
    coat_tilt: 0.0,
    along: None,
    sheen: 0.0,
    sheen_roughness: 0.0,
    film: None,
};

/// A thin film, by KHR_materials_iridescence.
#[derive(Clone, Copy, Debug)]
struct Film {
    factor: f64,
    ior: f64,
    /// In nanometres.
    thickness: f64,
}

impl Film {
    const fn new(factor: f64, ior: f64, thickness: f64) -> Film {
        Film { factor, ior, thickness }
    }

    /// Airy's reflectance of film and base for a phase between two reflections, from the amplitudes that each interface
    /// reflects. These are negative towards a higher index.
    fn airy(outer: f64, base: f64, phase: f64) -> f64 {
        let both = 2.0 * outer * base * phase.cos();
        (outer * outer + base * base + both) / (1.0 + outer * outer * base * base + both)
    }

    /// The eye's response, in linear sRGB, to a spectrum that is a cosine of the wave number times a path in
    /// nanometres: the Gaussians of the extension.
    fn response(path: f64) -> DVec3 {
        let gaussian = |value: f64, position: f64, variance: f64| {
            let phase = TAU * path * 1e-9;
            value * (TAU * variance).sqrt() * (position * phase).cos() * (-phase * phase * variance).exp() / 1.0685e-7
        };
        let x = gaussian(5.4856e-13, 1.6810e6, 4.3278e9) + gaussian(9.7470e-14, 2.2399e6, 4.5282e9);
        let (y, z) = (gaussian(4.4201e-13, 1.7953e6, 9.3046e9), gaussian(5.2481e-13, 2.2084e6, 6.6121e9));
        let row = |a: f64, b: f64, c: f64| a * x + b * y + c * z;
        let red = row(3.2404542, -1.5371385, -0.4985314);
        let green = row(-0.9692660, 1.8760108, 0.0415560);
        DVec3::new(red, green, row(0.0556434, -0.2040259, 1.0572252))
    }

    /// Reflectance of the film over a base of reflectance `f0` at normal incidence: the mean of Airy's reflectance over
    /// all phases and its first two harmonics, by quadrature, with the eye's response to each.
    fn reflectance(&self, f0: f64, cosine: f64) -> DVec3 {
        const PHASES: usize = 2048;
        let interface = |from: f64, to: f64, cosine: f64| {
            let normal = ((to - from) / (to + from)).powi(2);
            (normal + (1.0 - normal) * (1.0 - cosine).powi(5)).sqrt() * if to < from { 1.0 } else { -1.0 }
        };
        let inner = (1.0 - (1.0 - cosine * cosine) / self.ior.powi(2)).sqrt();
        let root = f0.min(0.9999).sqrt();
        let outer = interface(1.0, self.ior, cosine);
        let base = interface(self.ior, (1.0 + root) / (1.0 - root), inner);
        let harmonic = |m: f64| {
            let at = |i: usize| TAU * (i as f64 + 0.5) / PHASES as f64;
            let terms = (0..PHASES).map(|i| Self::airy(outer, base, at(i)) * (m * at(i)).cos());
            terms.sum::<f64>() / PHASES as f64
        };
        let path = 2.0 * self.ior * self.thickness * inner;
        let waves = [1.0, 2.0].into_iter().map(|m| 2.0 * harmonic(m) * Self::response(m * path));
        (DVec3::splat(harmonic(0.0)) + waves.sum::<DVec3>()).clamp(DVec3::ZERO, DVec3::ONE)
    }
}

/// Fibres, by KHR_materials_sheen: Estevez and Kulla's distribution and their fit of its masking, in f64.
struct Fibres {
    alpha: f64,
}

impl Fibres {
    /// Minimum roughness, as in viewers of glTF.
    const MIN: f64 = 0.07;

    fn new(roughness: f64) -> Self {
        Fibres { alpha: roughness.max(Self::MIN).powi(2) }
    }

    fn lambda(&self, cosine: f64) -> f64 {
        let k = (1.0 - self.alpha).powi(2);
        let [a, b, c, d, e] =
            [(21.5473, 25.3245), (3.82987, 3.32435), (0.19823, 0.16801), (-1.97760, -1.27393), (-4.32054, -4.85967)]
                .map(|(rough, smooth)| (1.0 - k) * rough + k * smooth);
        let l = |x: f64| a / (1.0 + b * x.powf(c)) + d * x + e;
        if cosine < 0.5 { l(cosine).exp() } else { (2.0 * l(0.5) - l(1.0 - cosine)).exp() }
    }

    /// The extension's formula for a white sheen.
    fn value(&self, view: DVec3, light: DVec3) -> f64 {
        let h = (view + light).normalize();
        let d = (2.0 + 1.0 / self.alpha) * h.truncate().length().powf(1.0 / self.alpha) / TAU;
        d / ((1.0 + self.lambda(view.z) + self.lambda(light.z)) * 4.0 * view.z * light.z)
    }

    /// Its directional albedo, by midpoints that are denser near the horizon.
    fn albedo(&self, cosine: f64) -> f64 {
        const N: usize = 48;
        let view = DVec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
        let mut sum = 0.0;
        for i in 0..N {
            let t = (i as f64 + 0.5) / N as f64;
            let z = t * t;
            for j in 0..N {
                let (s, c) = (PI * (j as f64 + 0.5) / N as f64).sin_cos();
                let across = (1.0 - z * z).sqrt();
                sum += self.value(view, DVec3::new(across * c, across * s, z)) * z * 2.0 * t;
            }
        }
        sum * TAU / (N * N) as f64
    }
}

/// Colour of light that is transmitted diffusely.
const DIFFUSED: f64 = 0.9;

/// Reflectance of glTF's dielectric: index of refraction 1.5.
const DIELECTRIC: f64 = 0.04;

impl Tested {
    fn f0(&self) -> f64 {
        DIELECTRIC + (self.base - DIELECTRIC) * self.metallic
    }

    fn albedo(&self) -> f64 {
        self.base * (1.0 - self.metallic) * (1.0 - self.lobes.transmission) * (1.0 - self.lobes.diffused)
    }

    /// Transmittance of the diffuse base.
    fn diffuse_tint(&self) -> f64 {
        DIFFUSED * self.lobes.diffused * (1.0 - self.metallic) * (1.0 - self.lobes.transmission)
    }

    fn alpha(&self) -> DVec2 {
        let across = self.roughness.powi(2);
        DVec2::new(self.lobes.along.map_or(across, |r| r.powi(2)), across).max(DVec2::splat(1e-3))
    }

    /// The cosine on the side of the lower index, for one on a side whose index is `eta` times that of the other side.
    /// `None` for total internal reflection.
    fn outer(eta: f64, cosine: f64) -> Option<f64> {
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt() * eta.max(1.0);
        (sine < 1.0).then(|| (1.0 - sine * sine).sqrt())
    }

    /// Schlick's term at a microfacet: of the angle on the side of the lower index.
    fn schlick(&self, f0: f64, cosine: f64) -> f64 {
        Self::outer(self.lobes.eta, cosine).map_or(1.0, |outer| f0 + (1.0 - f0) * (1.0 - outer).powi(5))
    }

    /// The same with the film, if there is one, in each of the three colours.
    fn fresnel(&self, f0: f64, cosine: f64) -> DVec3 {
        let bare = DVec3::splat(self.schlick(f0, cosine));
        self.lobes.film.map_or(bare, |film| {
            let outer = Self::outer(self.lobes.eta, cosine);
            let of_film = outer.map_or(DVec3::ONE, |outer| film.reflectance(self.f0(), outer));
            bare.lerp(of_film, film.factor)
        })
    }

    /// The share that the specular lobe transmits to the base, from light at an angle with that cosine, on a side whose
    /// index is `eta` times that of the other side. What is reflected totally does not reach the base, nor the viewer
    /// from it. With a film the share is that at both angles, after the largest colour component is reflected.
    fn through_specular(&self, eta: f64, light_z: f64) -> f64 {
        let [Some(light_z), Some(view_z)] = [Self::outer(eta, light_z), Self::outer(self.lobes.eta, self.view.z)]
        else {
            return 0.0;
        };
        let bare = Self::through(DIELECTRIC, self.roughness, light_z, view_z);
        self.lobes.film.map_or(bare, |film| {
            let kept = |z: f64| {
                let grazing = 1.0 - 0.9 * self.roughness.powi(2) * (1.0 - z).powi(5);
                film.reflectance(self.f0(), z).max_element() * grazing
            };
            bare + (1.0 - kept(light_z).max(kept(view_z)) - bare) * film.factor
        })
    }

    /// Distribution (GGX, of a half vector), and Smith's height-correlated masking over four times both cosines.
    fn microfacets(view: DVec3, h: DVec3, light: DVec3, alpha: DVec2) -> f64 {
        let slope = DVec2::new(h.x, h.y) / alpha;
        // By the tangent part: 1 - z^2 would cancel.
        let d = 1.0 / (PI * alpha.x * alpha.y * (slope.length_squared() + h.z * h.z).powi(2));
        let root = |v: DVec3| ((v.x * alpha.x).powi(2) + (v.y * alpha.y).powi(2) + v.z * v.z).sqrt();
        d * 0.5 / (light.z.abs() * root(view) + view.z * root(light))
    }

    /// The share that a layer of reflectance `f0` at normal incidence transmits, at the lower of the two directions.
    fn through(f0: f64, roughness: f64, light_z: f64, view_z: f64) -> f64 {
        let grazing = (1.0 - 0.9 * roughness.powi(2)).max(f0);
        1.0 - (f0 + (grazing - f0) * (1.0 - light_z.min(view_z)).powi(5))
    }

    /// A direction in the frame of the coat's normal.
    fn about_coat(&self, v: DVec3) -> DVec3 {
        DQuat::from_rotation_y(-self.lobes.coat_tilt) * v
    }

    /// The share of light that the coat transmits. The base may face light that is below the coat's horizon. The coat
    /// transmits it as at the horizon; a smooth coat transmits nothing.
    fn through_coat(&self, light: DVec3) -> f64 {
        let [light_z, view_z] = [light, self.view].map(|v| self.about_coat(v).z);
        let light_z = (light_z * light.z.signum()).max(0.0);
        1.0 - self.lobes.coat * (1.0 - Self::through(DIELECTRIC, self.lobes.coat_roughness, light_z, view_z))
    }

    fn geometric_normal(&self) -> DVec3 {
        DVec3::new(self.tilt.sin(), 0.0, self.tilt.cos())
    }

    /// Light from the other side, refracted and scattered.
    fn passed(&self, light: DVec3) -> f64 {
        let diffused = self.diffuse_tint() / PI * self.through_specular(1.0 / self.lobes.eta, -light.z);
        (self.refracted(light) + diffused) * self.through_coat(light) * self.fibres(light).1
    }

    /// Transmitted light (Walter et al. 2007, equation 21; for a thin wall, the mirror image of what is reflected).
    fn refracted(&self, light: DVec3) -> f64 {
        let eta = self.lobes.eta;
        let tint = self.base * (1.0 - self.metallic) * self.lobes.transmission;
        if eta == 1.0 {
            let mirrored = light * DVec3::new(1.0, 1.0, -1.0);
            let h = (mirrored + self.view).normalize();
            let fresnel = self.fresnel(DIELECTRIC, self.view.dot(h)).max_element();
            return tint * (1.0 - fresnel) * Self::microfacets(self.view, h, mirrored, self.alpha());
        }
        let bent = (light + eta * self.view).normalize();
        let h = if bent.z < 0.0 { -bent } else { bent };
        let (vh, lh) = (self.view.dot(h), light.dot(h));
        if vh <= 0.0 || lh >= 0.0 {
            return 0.0;
        }
        let fresnel = self.fresnel(DIELECTRIC, vh).max_element();
        4.0 * tint
            * (1.0 - fresnel)
            * vh
            * -lh
            * (eta / (lh + eta * vh)).powi(2)
            * Self::microfacets(self.view, h, light, self.alpha())
    }

    /// KHR_materials_sheen: the light that fibres reflect, scaled down where their albedo from either side would be
    /// above 1; and the share that they leave to the layers below.
    fn fibres(&self, light: DVec3) -> (f64, f64) {
        if self.lobes.sheen == 0.0 {
            return (0.0, 1.0);
        }
        let fibres = Fibres::new(self.lobes.sheen_roughness);
        let albedo = fibres.albedo(self.view.z).max(fibres.albedo(light.z.abs()));
        let value = if light.z > 0.0 { fibres.value(self.view, light) } else { 0.0 };
        (self.lobes.sheen * value / albedo.max(1.0), 1.0 - self.lobes.sheen * albedo.min(1.0))
    }

    /// glTF 2.0, appendix B, and KHR_materials_clearcoat. Dielectric and coat transmit by the more grazing of the two
    /// directions, and reflect less at grazing angles where they are rough. Each lobe is multiplied by the cosine to
    /// its normal.
    fn values(&self, light: DVec3) -> DVec3 {
        if light.dot(self.geometric_normal()) < 0.0 {
            return DVec3::splat(if light.z < 0.0 { self.passed(light) * -light.z } else { 0.0 });
        }
        let base = if light.z > 0.0 { self.reflected(light) * light.z } else { DVec3::ZERO };
        let [view, light] = [self.view, light].map(|v| self.about_coat(v));
        if light.z <= 0.0 {
            return base;
        }
        let h = (light + view).normalize();
        let alpha = DVec2::splat(self.lobes.coat_roughness.powi(2).max(1e-3));
        let fresnel = DIELECTRIC + (1.0 - DIELECTRIC) * (1.0 - view.dot(h)).powi(5);
        base + self.lobes.coat * fresnel * Self::microfacets(view, h, light, alpha) * light.z
    }

    /// The red component; only films are not grey.
    fn value(&self, light: DVec3) -> f64 {
        self.values(light).x
    }

    /// The light reflected by base and fibres.
    fn reflected(&self, light: DVec3) -> DVec3 {
        let h = (light + self.view).normalize();
        let fresnel = self.fresnel(self.f0(), self.view.dot(h));
        let base = self.albedo() / PI * self.through_specular(self.lobes.eta, light.z)
            + fresnel * Self::microfacets(self.view, h, light, self.alpha());
        let (sheen, through) = self.fibres(light);
        (sheen + base * through) * self.through_coat(light)
    }

    /// The direction that a smooth surface would send the view to: refracted if it transmits light, else reflected.
    fn main_direction(&self) -> DVec3 {
        let v = self.view;
        if self.lobes.transmission == 0.0 {
            return DVec3::new(-v.x, -v.y, v.z);
        }
        // In total reflection: near the grazing direction.
        let across = (-v.truncate() * self.lobes.eta).clamp_length_max(0.9);
        across.extend(-(1.0 - across.length_squared()).sqrt())
    }

    /// The specular lobe with reflectance 1, times the cosine.
    fn lobe(&self, light: DVec3) -> f64 {
        let h = (light + self.view).normalize();
        Self::microfacets(self.view, h, light, self.alpha()) * light.z.abs()
    }

    /// Width of its narrowest lobe.
    fn narrowest(&self) -> f64 {
        let coat = if self.lobes.coat > 0.0 { self.lobes.coat_roughness.powi(2).max(1e-3) } else { 1.0 };
        self.alpha().min_element().min(coat)
    }
}

fn features(gpu: &Gpu, t: &Tested) -> Features {
    let specialisation = [
        (Feature::Glossy, t.glossy),
        (Feature::Transmission, t.lobes.transmission > 0.0 || t.lobes.diffused > 0.0),
        (Feature::DiffuseTransmission, t.lobes.diffused > 0.0),
        (Feature::Clearcoat, t.lobes.coat > 0.0),
        (Feature::CoatNormals, t.lobes.coat_tilt != 0.0),
        (Feature::Anisotropy, t.lobes.along.is_some()),
        (Feature::Sheen, t.lobes.sheen > 0.0),
        (Feature::Iridescence, t.lobes.film.is_some()),
    ];
    specialisation.into_iter().fold(device_features(gpu), |features, (feature, on)| features.with(feature, on))
}

/// The test kernel, made once for all surfaces that use it.
fn kernel(gpu: &Gpu, features: Features, count: usize, stratified: bool) -> Arc<Kernel> {
    type Made = Mutex<HashMap<(Features, usize, bool), Arc<Kernel>>>;
    static MADE: LazyLock<Made> = LazyLock::new(Made::default);
    let mut made = MADE.lock().unwrap();
    let made = made.entry((features, count, stratified)).or_insert_with_key(|(features, ..)| {
        let composed = compose_source("bsdf", include_str!("shaders/bsdf.wgsl"), features).unwrap();
        let constants = [
            ("count", count as f64),
            ("seed", 4242.0),
            ("stratified", f64::from(u8::from(stratified))),
            ("min_sheen_roughness", Fibres::MIN),
        ];
        Arc::new(new_kernel(gpu, &composed, &composed.overrides(&constants), &[]).unwrap())
    });
    made.clone()
}

/// Runs an entry of the test kernel: two vectors for each of `count` items.
fn run(gpu: &Gpu, entry: &str, tested: &Tested, directions: &[DVec3], count: usize, stratified: bool) -> Vec<[f32; 4]> {
    let kernel = kernel(gpu, features(gpu, tested), count, stratified);
    let t = tested;
    let (albedo, f0) = (t.albedo() as f32, t.f0() as f32);
    let tint = (t.base * (1.0 - t.metallic) * t.lobes.transmission) as f32;
    let view = t.view.as_vec3();
    let surface = [
        [albedo, albedo, albedo, (t.roughness * t.roughness) as f32],
        [f0, f0, f0, 1.0],
        [DIELECTRIC as f32, 1.0, t.tilt.sin() as f32, t.tilt.cos() as f32],
        [0.0, 0.0, 1.0, t.lobes.coat_tilt.sin() as f32],
        [view.x, view.y, view.z, t.lobes.coat_tilt.cos() as f32],
        [tint, tint, tint, t.lobes.eta as f32],
        [t.lobes.coat as f32, t.lobes.coat_roughness.powi(2) as f32, t.alpha().x as f32, 0.0],
        [t.lobes.sheen as f32, t.lobes.sheen as f32, t.lobes.sheen as f32, t.lobes.sheen_roughness as f32],
        t.lobes.film.map_or([0.0; 4], |film| [film.factor as f32, film.ior as f32, film.thickness as f32, 0.0]),
        [t.diffuse_tint() as f32, t.diffuse_tint() as f32, t.diffuse_tint() as f32, 0.0],
    ];
    let surface = gpu.upload("test/surface", &surface).unwrap();
    let directions: Vec<glam::Vec4> = directions.iter().map(|d| d.as_vec3().extend(0.0)).collect();
    let directions = gpu.upload("test/directions", &directions).unwrap();
    let results = gpu.poisoned::<[f32; 4]>("test/results", count * 2).unwrap();
    let sobol = sobol::upload(gpu).unwrap();
    static SHEEN: OnceLock<Buffer> = OnceLock::new();
    let sheen = SHEEN.get_or_init(|| sheen::upload(gpu).unwrap());
    let sets = Resources::new()
        .with("surface", &surface)
        .with("directions", &directions)
        .with("results", &results)
        .with("sobol_directions", &sobol)
        .with("sheen_albedos", sheen);
    let bound = kernel.bind(gpu, entry, &[&sets]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, count as u32, &[0u32; 0]);
    frame.submit().unwrap();
    let got = gpu.read::<[f32; 4]>(&results, count * 2).unwrap();
    assert!(got.iter().flatten().all(|v| v.is_finite()), "poison or worse in {entry} of {tested:?}");
    got
}

fn view(cosine: f64) -> DVec3 {
    DVec3::new((1.0 - cosine * cosine).sqrt() * 0.8, (1.0 - cosine * cosine).sqrt() * 0.6, cosine)
}

/// Roughness and metallic over their ranges, viewed from above and from a low angle.
fn all_tested(base: f64) -> Vec<Tested> {
    let mut all = Vec::new();
    for roughness in [0.05, 0.2, 0.5, 1.0, 0.0] {
        for metallic in [0.0, 0.5, 1.0] {
            for cosine in [0.95, 0.25] {
                let lobes = NO_LOBES;
                all.push(Tested { base, roughness, metallic, view: view(cosine), tilt: 0.0, glossy: true, lobes });
            }
        }
    }
    all
}

/// Roughness and cosine of the view for each kind of surface.
const ROUGHNESS_AND_VIEW: [(f64, f64); 6] = [(0.3, 0.95), (0.3, 0.4), (0.7, 0.95), (0.7, 0.4), (0.0, 0.95), (0.0, 0.4)];

/// Surfaces with more lobes: glass from outside and inside, thin walls, coats, brushed metal, velvets, films, and
/// all at once.
fn all_lobes(base: f64) -> Vec<Tested> {
    let glass = |transmission, eta| Lobes { transmission, eta, ..NO_LOBES };
    let velvet = |sheen, sheen_roughness| Lobes { sheen, sheen_roughness, ..NO_LOBES };
    let film = |factor, ior, thickness| Lobes { film: Some(Film::new(factor, ior, thickness)), ..NO_LOBES };
    let kinds = [
        (0.0, glass(1.0, 1.0 / 1.5)),
        (0.0, glass(1.0, 1.5)),
        (0.0, glass(0.6, 1.0 / 1.5)),
        (0.0, glass(0.5, 1.5)),
        (0.0, Lobes { diffused: 0.6, ..glass(0.4, 1.5) }),
        (0.0, glass(1.0, 1.0)),
        (0.0, Lobes { diffused: 0.6, ..NO_LOBES }),
        (0.0, Lobes { diffused: 0.4, coat: 0.5, coat_roughness: 0.4, ..glass(0.4, 1.0 / 1.5) }),
        (0.0, Lobes { coat: 1.0, coat_roughness: 0.3, ..NO_LOBES }),
        (1.0, Lobes { coat: 0.7, coat_roughness: 0.5, ..NO_LOBES }),
        (1.0, Lobes { along: Some(0.9), ..NO_LOBES }),
        (0.0, velvet(0.8, 0.1)),
        (0.0, velvet(1.0, 0.5)),
        (1.0, velvet(0.6, 1.0)),
        (0.0, film(1.0, 1.3, 400.0)),
        (1.0, film(0.8, 1.8, 250.0)),
        (0.0, Lobes { film: Some(Film::new(1.0, 1.4, 550.0)), ..glass(0.6, 1.0 / 1.5) }),
        (
            0.3,
            Lobes {
                transmission: 0.5,
                eta: 1.5,
                diffused: 0.0,
                coat: 0.5,
                coat_roughness: 0.4,
                coat_tilt: 0.0,
                along: Some(0.8),
                sheen: 0.7,
                sheen_roughness: 0.3,
                film: Some(Film::new(0.5, 1.3, 300.0)),
            },
        ),
    ];
    let mut all = Vec::new();
    for (metallic, lobes) in kinds {
        for (roughness, cosine) in ROUGHNESS_AND_VIEW {
            all.push(Tested { base, roughness, metallic, view: view(cosine), tilt: 0.0, glossy: true, lobes });
        }
    }
    all
}

/// Surfaces whose coats have normals of their own, some of which face directions that the base does not.
fn all_tilted_coats(base: f64) -> Vec<Tested> {
    let coat = |coat, coat_roughness, coat_tilt| Lobes { coat, coat_roughness, coat_tilt, ..NO_LOBES };
    let all = Lobes {
        transmission: 0.5,
        eta: 1.5,
        along: Some(0.8),
        sheen: 0.7,
        sheen_roughness: 0.3,
        ..coat(0.5, 0.4, -0.3)
    };
    let kinds = [(0.0, coat(1.0, 0.4, 0.6), 0.4), (1.0, coat(0.7, 0.5, -0.4), -0.2), (0.3, all, 0.0)];
    let tested = |(metallic, lobes, tilt), cosine| Tested {
        base,
        roughness: 0.5,
        metallic,
        view: view(cosine),
        tilt,
        glossy: true,
        lobes,
    };
    kinds.into_iter().flat_map(|kind| [0.9, 0.5].map(|cosine| tested(kind, cosine))).collect()
}

/// Directions of light over both hemispheres, and near the main direction.
fn some_directions(tested: &Tested) -> Vec<DVec3> {
    let mut random = Random(5);
    let main = tested.main_direction();
    let all = (0..1000).map(|i| {
        let d = random.direction();
        let passes = tested.lobes.transmission > 0.0 || tested.lobes.diffused > 0.0;
        let both_sides = passes || tested.lobes.coat_tilt != 0.0;
        let z = if both_sides { d.z } else { d.z.abs() };
        if i % 2 == 0 { DVec3::new(d.x, d.y, z) } else { (main + d * 0.02).normalize() }
    });
    // At grazing angles a cosine has few digits in f32: 1e-7 of 0.02 is 5e-6, which enters four factors.
    all.filter(|d| d.z.abs() > 0.02).collect()
}

/// BSDF times cosine equals glTF's formulas, as a whole and as the sum of its two parts, and is 0 below the horizon of
/// either normal.
#[kernel_test("PENUMBRA_DEVICE")]
fn values_are_those_of_gltf(gpu: &Gpu) {
    let (mut worst, mut worst_of_fault, mut worst_of_thicker_film) = (0f64, 0f64, 0f64);
    let mut worst_case = String::new();
    for tested in [all_tested(0.7), all_lobes(0.7), all_tilted_coats(0.7)].concat() {
        let mut directions = some_directions(&tested);
        if tested.lobes.sheen > 0.0 || tested.lobes.film.is_some() {
            // The oracle integrates for each direction.
            directions.truncate(150);
        }
        let got = run(gpu, "evaluated", &tested, &directions, directions.len(), false);
        for (direction, got) in directions.iter().zip(got.chunks_exact(2)) {
            // The kernel's directions are f32, 6e-8 off: a lobe as narrow as alpha changes by 4 * 6e-8 / alpha.
            // The error of the fibres' albedo is 1.5e-3. Relative to the little light that fibres leave to the base, it
            // is larger.
            let table = if tested.lobes.sheen > 0.0 { 2e-3 / (1.0 - tested.lobes.sheen).max(0.1) } else { 0.0 };
            let allowed = 1e-4 + 1e-6 / tested.narrowest() + table;
            // Near total reflection, transmission is proportional to the square root of the distance to it: 1e-7 in f32
            // is 3e-4 of the lobe.
            let floor = if tested.lobes.eta > 1.0 { 3e-6 } else { 1e-9 };
            // A film's colours are differences of waves that nearly cancel.
            // Phases are up to 43 (3080 nm at 2.24e6 / m), off by 3e-6 in f32. The matrix to linear sRGB
            // multiplies that by up to 5.
            let left = if tested.lobes.film.is_some() { 2e-5 * tested.lobe(*direction) } else { 0.0 };
            let off = |v: f32, exact: f64| (f64::from(v) - exact).abs() / ((exact * allowed).max(floor) + left);
            let exact = tested.values(direction.as_vec3().as_dvec3()).to_array();
            let here = (0..3).map(|i| off(got[0][i], exact[i]).max(off(got[1][i], exact[i]))).fold(0.0, f64::max);
            if here > worst {
                (worst, worst_case) = (here, format!("{tested:?} {direction} {exact:?} {got:?}"));
            }
            worst_of_fault = worst_of_fault.max(off(got[0][0], exact[0] * 1.002));
            if let Some(film) = tested.lobes.film {
                let thicker = Film { thickness: film.thickness * 1.002, ..film };
                let thicker = Tested { lobes: Lobes { film: Some(thicker), ..tested.lobes }, ..tested };
                let exact = thicker.values(*direction).to_array();
                let here = (0..3).map(|i| off(got[0][i], exact[i])).fold(0.0, f64::max);
                worst_of_thicker_film = worst_of_thicker_film.max(here);
            }
        }
    }
    assert!(worst <= 1.0, "{worst} of what is allowed: {worst_case}");
    assert!(worst_of_fault > 1.0, "an oracle that is 0.2 % off");
    // Above 1 the comparison notices such a film; 2 leaves a margin.
    assert!(worst_of_thicker_film > 2.0, "films of another thickness: {worst_of_thicker_film} of what is allowed");

    let tilted =
        Tested { base: 0.7, roughness: 0.5, metallic: 0.0, view: view(0.9), tilt: 0.5, glossy: true, lobes: NO_LOBES };
    let mut random = Random(8);
    let directions: Vec<DVec3> = (0..500).map(|_| random.direction()).collect();
    for glossy in [false, true] {
        let got = run(gpu, "evaluated", &Tested { glossy, ..tilted }, &directions, directions.len(), false);
        for (d, got) in directions.iter().zip(got.chunks_exact(2)) {
            let over_both = d.z > 0.0 && d.x * 0.5f64.sin() + d.z * 0.5f64.cos() > 0.0;
            assert_eq!(got[0][0] > 0.0, over_both, "{d}");
            assert_eq!(got[0][3] > 0.0, over_both, "{d}");
        }
    }
}

/// No direction is sampled with a density above the bound. It is reached at the mirror direction of metals. A bound
/// that does not depend on the view would be exceeded.
#[kernel_test("PENUMBRA_DEVICE")]
fn no_density_exceeds_its_maximum(gpu: &Gpu) {
    let (mut nearest, mut over_fault) = (0f64, 0);
    for tested in [all_tested(0.7), all_lobes(0.7), all_tilted_coats(0.7)].concat() {
        let directions = some_directions(&tested);
        let got = run(gpu, "evaluated", &tested, &directions, directions.len(), false);
        for (direction, got) in directions.iter().zip(got.chunks_exact(2)) {
            let (density, max) = (f64::from(got[0][3]), f64::from(got[1][3]));
            // Both are f32: narrow lobes lose digits, as in the test of values.
            assert!(
                density <= max * (1.0 + 1e-4 + 1e-6 / tested.narrowest()),
                "{tested:?} {direction}: {density} {max}"
            );
            nearest = nearest.max(density / max);
            let from_above = 0.25 / (PI * tested.narrowest().powi(2));
            // A hundredth: a hundred times the roundings of wide lobes above.
            over_fault += usize::from(density > 1.01 * from_above.max(1.0 / PI));
        }
    }
    // Some directions are within 0.02 of the mirror direction: half vectors within 0.01, where D is 0.3 % lower at an
    // alpha of 0.25.
    assert!(nearest > 0.98, "the bound is {nearest} times as high as any density");
    assert!(over_fault > 100, "{over_fault} directions tell views apart");
}

/// Transmission is reciprocal: swapping light and view keeps the value, divided by the squared index of refraction.
#[kernel_test("PENUMBRA_DEVICE")]
fn transmission_is_reciprocal(gpu: &Gpu) {
    let mut compared = 0;
    // Only refracted light is concentrated: surfaces with both are no simple multiple.
    let is_reciprocal =
        |t: &Tested| if t.lobes.diffused > 0.0 { t.lobes.eta == 1.0 } else { t.lobes.transmission > 0.0 };
    for tested in all_lobes(0.7).into_iter().filter(is_reciprocal) {
        let below = |d: &DVec3| d.z < -0.1;
        let directions: Vec<DVec3> = some_directions(&tested).into_iter().filter(below).take(4).collect();
        let there = run(gpu, "evaluated", &tested, &directions, directions.len(), false);
        for (direction, there) in directions.iter().zip(there.chunks_exact(2)) {
            // Seen from the other side, with the normal reversed.
            let turned = |d: DVec3| d * DVec3::new(1.0, 1.0, -1.0);
            let lobes = Lobes { eta: 1.0 / tested.lobes.eta, coat_tilt: -tested.lobes.coat_tilt, ..tested.lobes };
            let other = Tested { view: turned(*direction), lobes, ..tested };
            let back = run(gpu, "evaluated", &other, &[turned(tested.view)], 1, false);
            let there = f64::from(there[0][0]) / -direction.z / tested.lobes.eta.powi(2);
            let back = f64::from(back[0][0]) / tested.view.z;
            // A lobe of alpha 1e-3 is off by 4 * 6e-8 / 1e-3 = 2.4e-4, as in the test of values, in each evaluation.
            assert!((there - back).abs() <= 1e-3 * there.max(back) + 1e-6, "{tested:?} {direction}: {there} {back}");
            compared += usize::from(there > 1e-3 && tested.lobes.eta != 1.0);
        }
    }
    assert!(compared > 20, "{compared} refracted directions");
}

/// Reflection is reciprocal: swapping light and view keeps the value.
#[kernel_test("PENUMBRA_DEVICE")]
fn reflection_is_reciprocal(gpu: &Gpu) {
    for tested in [all_tested(0.7), all_lobes(0.7)].concat() {
        let directions: Vec<DVec3> = some_directions(&tested).into_iter().filter(|d| d.z > 0.1).take(24).collect();
        let there = run(gpu, "evaluated", &tested, &directions, directions.len(), false);
        for (direction, there) in directions.iter().zip(there.chunks_exact(2)) {
            let back = run(gpu, "evaluated", &Tested { view: *direction, ..tested }, &[tested.view], 1, false);
            let (there, back) = (f64::from(there[0][0]) / direction.z, f64::from(back[0][0]) / tested.view.z);
            // As for transmission: twice 2.4e-4 of lobes of alpha 1e-3.
            assert!((there - back).abs() <= 1e-3 * there.max(back), "{tested:?} {direction}: {there} {back}");
        }
    }
    // A tilted coat is reciprocal about its own normal. The black mirror below it reflects only in the mirror's
    // direction.
    let mut swapped_of_base = 0f64;
    for coat_tilt in [0.3, -0.5] {
        let lobes = Lobes { coat: 1.0, coat_roughness: 0.6, coat_tilt, ..NO_LOBES };
        let tested =
            Tested { base: 0.0, roughness: 0.0, metallic: 0.0, view: view(0.8), tilt: 0.0, glossy: true, lobes };
        for direction in [DVec3::new(0.5, -0.3, 0.8), DVec3::new(-0.2, 0.6, 0.7)].map(DVec3::normalize) {
            let there = f64::from(run(gpu, "evaluated", &tested, &[direction], 1, false)[0][0]);
            let back = run(gpu, "evaluated", &Tested { view: direction, ..tested }, &[tested.view], 1, false);
            let back = f64::from(back[0][0]);
            let over_cosines = |of: &dyn Fn(DVec3) -> f64| [there / of(direction), back / of(tested.view)];
            let [a, b] = over_cosines(&|d| tested.about_coat(d).z);
            assert!((a - b).abs() <= 1e-3 * a.max(b) && a > 1e-3, "{tested:?} {direction}: {a} {b}");
            let [a, b] = over_cosines(&|d| d.z);
            swapped_of_base = swapped_of_base.max((a / b - 1.0).abs());
        }
    }
    // A hundred times the tolerance of reciprocity.
    assert!(swapped_of_base > 0.1, "the base's cosines instead of the coat's: {swapped_of_base}");
    // The planted fault: a Fresnel term of one angle only, as in many renderers.
    let tested =
        Tested { base: 0.7, roughness: 1.0, metallic: 0.0, view: view(0.95), tilt: 0.0, glossy: true, lobes: NO_LOBES };
    let one_sided = |t: &Tested, l: DVec3| t.value(l) * (1.0 - (1.0 - t.view.z).powi(5));
    let (there, back) =
        (one_sided(&tested, view(0.25)), one_sided(&Tested { view: view(0.25), ..tested }, tested.view));
    assert!((there - back).abs() > 1e-3 * there);
}

/// No surface reflects more light than it receives, from any side. A smooth mirror and a white Lambertian surface
/// reflect all of it.
#[kernel_test("PENUMBRA_DEVICE")]
fn no_surface_makes_light(gpu: &Gpu) {
    const N: usize = 1 << 14;
    let albedo = |tested: &Tested| {
        let got = run(gpu, "sampled", tested, &[], N, true);
        got.chunks_exact(2).map(|s| f64::from(s[1][3])).sum::<f64>() / N as f64
    };
    // One surface of each kind, with the roughness and views of this test.
    let tilted = all_tilted_coats(1.0).into_iter().step_by(2);
    for lobed in all_lobes(1.0).into_iter().step_by(ROUGHNESS_AND_VIEW.len()).chain(tilted) {
        for (cosine, roughness) in [1.0, 0.5, 0.1, 0.02].into_iter().flat_map(|c| [(c, 0.0), (c, 0.3), (c, 1.0)]) {
            let tested = Tested { view: view(cosine), roughness, ..lobed };
            let a = albedo(&tested);
            // A tilted coat may reflect into the surface, where light is lost.
            let min = if lobed.lobes.coat_tilt == 0.0 { 0.05 } else { 0.0 };
            assert!((min..=1.0 + 1e-3).contains(&a), "{tested:?} returns {a}");
            // Smooth glass loses nothing.
            if roughness == 0.0 && lobed.lobes.transmission == 1.0 && cosine > 0.3 {
                assert!((a - 1.0).abs() < 2e-3, "{tested:?} returns {a}");
            }
        }
    }
    // A white base under white fibres. By the extension's formula alone, smooth fibres would reflect more than they
    // receive.
    assert!(Fibres::new(0.0).albedo(0.02) > 1.9);
    for sheen_roughness in [0.0, 0.1, 0.2, 0.4, 0.7, 1.0] {
        for cosine in [0.7, 0.1, 0.02] {
            let lobes = Lobes { sheen: 1.0, sheen_roughness, ..NO_LOBES };
            let (base, roughness, metallic) = (1.0, 0.5, 0.0);
            let tested = Tested { base, roughness, metallic, view: view(cosine), tilt: 0.0, glossy: true, lobes };
            let a = albedo(&tested);
            assert!((0.3..=1.0 + 1e-3).contains(&a), "{tested:?} returns {a}");
        }
    }
    for roughness in [0.0, 0.05, 0.2, 0.5, 1.0] {
        for metallic in [0.0, 0.5, 1.0] {
            for cosine in [1.0, 0.7, 0.3, 0.1, 0.02] {
                let tested = Tested {
                    base: 1.0,
                    roughness,
                    metallic,
                    view: view(cosine),
                    tilt: 0.0,
                    glossy: true,
                    lobes: NO_LOBES,
                };
                let a = albedo(&tested);
                assert!((0.05..=1.0 + 1e-3).contains(&a), "{tested:?} returns {a}");
                // From above, a white surface stays white under any layer: the masking of a rough layer takes 4 %.
                if metallic == 0.0 && cosine >= 0.7 {
                    assert!(a > 0.93, "{tested:?} returns {a}");
                }
                if metallic == 1.0 && roughness <= 0.05 && cosine > 0.2 {
                    // Masking takes 1e-5 at such a roughness; the rest is the error of the samples.
                    assert!(a > 0.998, "{tested:?} returns {a}");
                }
            }
        }
    }
    let white =
        Tested { base: 1.0, roughness: 1.0, metallic: 0.0, view: view(0.5), tilt: 0.0, glossy: false, lobes: NO_LOBES };
    // All samples of a Lambertian surface have the same weight, but for roundings of f32.
    assert!((albedo(&white) - 1.0).abs() < 1e-6);
}

/// A film conserves energy in every colour, for any index and thickness: colours are clamped to sRGB, and the base
/// receives 1 minus the largest component. Without the clamp some reflectances would exceed 1.
#[kernel_test("PENUMBRA_DEVICE")]
fn films_make_no_light(gpu: &Gpu) {
    const N: usize = 1 << 11;
    let mut largest = 0f64;
    for (ior, thickness) in [1.05, 1.33, 1.8, 2.5].into_iter().flat_map(|i| [60.0, 250.0, 600.0].map(|t| (i, t))) {
        for (roughness, metallic) in [0.0, 0.4, 0.7, 1.0].into_iter().flat_map(|r| [0.0, 0.5, 1.0].map(|m| (r, m))) {
            for cosine in [1.0, 0.6, 0.3, 0.05] {
                let lobes = Lobes { film: Some(Film::new(1.0, ior, thickness)), ..NO_LOBES };
                let view = view(cosine);
                let tested = Tested { base: 1.0, roughness, metallic, view, tilt: 0.0, glossy: true, lobes };
                let got = run(gpu, "sampled", &tested, &[], N, true);
                assert!(got.chunks_exact(2).all(|s| s[1][..3].iter().all(|w| *w >= 0.0)), "{tested:?}: below 0");
                for i in 0..3 {
                    let a = got.chunks_exact(2).map(|s| f64::from(s[1][i])).sum::<f64>() / N as f64;
                    largest = largest.max(a);
                    assert!((0.05..=1.0 + 1e-3).contains(&a), "{tested:?} returns {a} of colour {i}");
                }
            }
        }
    }
    println!("a white surface under a film returns {largest} at most");
    // The extension's formula exceeds 1 before it is clamped: the sum of all waves, for constructive interference.
    assert!(Film::response(0.0).x > 1.2);
}

/// A film of factor 0 changes no surface, nor does a film of thickness 0; a film of factor 1 does.
#[kernel_test("PENUMBRA_DEVICE")]
fn no_film_changes_nothing(gpu: &Gpu) {
    let mut random = Random(3);
    let directions: Vec<DVec3> = (0..200).map(|_| random.direction()).map(|d| d.with_z(d.z.abs().max(0.05))).collect();
    for tested in all_tested(0.7).into_iter().filter(|t| t.roughness >= 0.2) {
        let values = |film: Option<Film>| {
            let lobes = Lobes { film, ..NO_LOBES };
            run(gpu, "evaluated", &Tested { lobes, ..tested }, &directions, directions.len(), false)
        };
        let bare = values(None);
        let differing = |film: Film, allowed: f32| {
            let differs = |(a, b): &(&f32, &f32)| (*a - *b).abs() > allowed * b.abs();
            let values = values(Some(film));
            values.iter().flatten().zip(bare.iter().flatten()).filter(differs).count()
        };
        // A few roundings of f32: a mix with a factor of 0.
        assert_eq!(differing(Film::new(0.0, 1.8, 400.0), 1e-6), 0, "{tested:?}");
        assert!(differing(Film::new(1.0, 1.8, 400.0), 1e-2) > 100, "{tested:?}");
        assert!(differing(Film::new(1e-3, 1.8, 400.0), 1e-6) > 100, "{tested:?}: a thousandth of a film");
    }
}

/// The reflectance that ends a path is the mean of the surface's albedo over all views, here measured by samples from
/// views that are evenly distributed over the cosine-weighted hemisphere.
#[kernel_test("PENUMBRA_DEVICE")]
fn paths_end_with_the_mean_reflectance(gpu: &Gpu) {
    const VIEWS: usize = 16;
    const N: usize = 1 << 12;
    let velvet = |sheen_roughness| Lobes { sheen: 0.8, sheen_roughness, ..NO_LOBES };
    let coat = |coat_roughness, coat_tilt| Lobes { coat: 1.0, coat_roughness, coat_tilt, ..NO_LOBES };
    let layers = [NO_LOBES, velvet(0.1), velvet(0.4), velvet(1.0)].into_iter();
    let layers = layers.chain([coat(0.1, 0.0), coat(0.3, 0.0), coat(0.7, 0.0), coat(0.3, 0.2), coat(0.7, 0.35)]);
    let cases = layers.flat_map(|lobes| [0.3, 0.8].map(|base| (base, lobes)));
    for (roughness, (base, lobes)) in [0.2, 0.5, 0.7, 1.0].into_iter().flat_map(|r| cases.clone().map(move |c| (r, c)))
    {
        // The error of the fits (0.004 of f0 and 0.0005), and of the views, none of which is lower than 10 degrees. The
        // fits of fibres have an error of 0.003, and fibres transmit the smallest share where the layer below reflects
        // most. Those of tilted coats have an error of 0.005; a smooth lobe under one, which reflects most where such a
        // coat transmits least, is too bright by 0.012.
        let allowed = match lobes {
            Lobes { coat_tilt, .. } if coat_tilt > 0.0 && roughness < 0.5 => 0.016,
            Lobes { coat_tilt, .. } if coat_tilt > 0.0 => 0.008,
            Lobes { sheen, .. } if sheen > 0.0 => 0.008,
            _ => 0.004,
        };
        let tested = Tested { base, roughness, metallic: 0.0, view: DVec3::Z, tilt: 0.0, glossy: true, lobes };
        let mean = (0..VIEWS).map(|i| {
            // Golden angles: views at all sides of a tilted coat.
            let view = DQuat::from_rotation_z(2.39996 * i as f64) * view(((i as f64 + 0.5) / VIEWS as f64).sqrt());
            let got = run(gpu, "sampled", &Tested { view, ..tested }, &[], N, true);
            got.chunks_exact(2).map(|s| f64::from(s[1][3])).sum::<f64>() / (N * VIEWS) as f64
        });
        let mean: f64 = mean.sum();
        let afar = f64::from(run(gpu, "seen_afar", &tested, &[], 1, true)[0][0]);
        assert!((afar - mean).abs() < allowed, "{tested:?} reflects {mean}, and {afar} afar");
        // The planted fault: a layer without masking, which brightened rooms of plastic by 6 %.
        let range = (1.0 - DIELECTRIC) * (1.0 - 0.9 * roughness * roughness);
        let planted = base * (1.0 - DIELECTRIC - range * 11.0 / 126.0) + DIELECTRIC + range / 21.0;
        let caught = (planted - mean).abs() > allowed;
        assert!(
            caught || roughness < 0.5 || lobes.coat > 0.0 || lobes.sheen > 0.0,
            "{tested:?}: {planted} would pass for {mean}"
        );
    }
}

/// Samples are distributed by their density, and a sample's weight is value times cosine over density. Samples are
/// counted in cells about the main direction, which widen with the distance to it; midpoints integrate the density in
/// each.
#[kernel_test("PENUMBRA_DEVICE")]
fn samples_follow_their_density(gpu: &Gpu) {
    const N: usize = 1 << 14;
    const RADII: usize = 16;
    const SECTORS: usize = 8;
    // Midpoints along each side of a cell. In a cell cut by the horizon the error is at most 1 / 24, below the spread
    // of its count.
    const POINTS: usize = 24;
    let min_angle = 1e-4f64;
    let steps = (PI / min_angle).ln();
    let mut all = all_tested(0.7);
    all.push(Tested { tilt: 0.4, ..all[12] });
    all.push(Tested { tilt: 0.4, ..all[13] });
    all.push(Tested { glossy: false, metallic: 0.0, ..all[20] });
    // The cells resolve a single, circular narrow lobe. Smooth glass has two lobes, and that of brushed metal is flat.
    all.extend(all_lobes(0.7).into_iter().filter(|t| t.roughness > 0.0));
    all.extend(all_tilted_coats(0.7));
    let family = all.len() as u32;
    for tested in &all {
        let mirror = tested.main_direction();
        let side = mirror.cross(DVec3::X).normalize();
        let up = mirror.cross(side);
        let cell = |d: DVec3| {
            let angle = mirror.cross(d).length().atan2(mirror.dot(d));
            let azimuth = (d.dot(up).atan2(d.dot(side)) / TAU).rem_euclid(1.0);
            let radius = ((angle / min_angle).max(1.0).ln() / steps * RADII as f64) as usize;
            radius.min(RADII - 1) * SECTORS + ((azimuth * SECTORS as f64) as usize).min(SECTORS - 1)
        };
        let mut midpoints = Vec::new();
        let mut solid_angles = Vec::new();
        for r in 0..RADII {
            // The innermost cells begin at 0, and their solid angles follow from that.
            let edge = |k: f64| {
                if r == 0 {
                    min_angle * (steps / RADII as f64).exp() * k
                } else {
                    min_angle * (steps * (r as f64 + k) / RADII as f64).exp()
                }
            };
            for s in 0..SECTORS {
                for i in 0..POINTS {
                    let (from, to) = (edge(i as f64 / POINTS as f64), edge((i + 1) as f64 / POINTS as f64));
                    let angle = (from + to) / 2.0;
                    // cos a - cos b, without cancellation.
                    let ring = 2.0 * angle.sin() * ((to - from) / 2.0).sin() * TAU / (SECTORS * POINTS) as f64;
                    for j in 0..POINTS {
                        let azimuth = TAU * (s as f64 + (j as f64 + 0.5) / POINTS as f64) / SECTORS as f64;
                        let across = side * azimuth.cos() + up * azimuth.sin();
                        midpoints.push(mirror * angle.cos() + across * angle.sin());
                        solid_angles.push(ring);
                    }
                }
            }
        }
        let densities = run(gpu, "evaluated", tested, &midpoints, midpoints.len(), false);
        let mut expected = vec![0.0; RADII * SECTORS + 1];
        for (i, solid_angle) in solid_angles.iter().enumerate() {
            expected[i / (POINTS * POINTS)] += f64::from(densities[2 * i][3]) * solid_angle * N as f64;
        }
        // Samples that point into the surface.
        let inside: f64 = expected.iter().sum();
        // The integral may exceed 1 by its own error, no more.
        assert!(inside < 1.01 * N as f64, "{tested:?}: the density integrates to {}", inside / N as f64);
        *expected.last_mut().unwrap() = (N as f64 - inside).max(0.0);
        let samples = run(gpu, "sampled", tested, &[], N, false);
        let mut observed = vec![0u64; RADII * SECTORS + 1];
        let mut directions = Vec::new();
        for s in samples.chunks_exact(2) {
            let d = DVec3::new(s[0][0].into(), s[0][1].into(), s[0][2].into());
            directions.push(d);
            if s[0][3] > 0.0 { observed[cell(d)] += 1 } else { observed[RADII * SECTORS] += 1 }
        }
        // The integral's own error may leave no expected count in the last cell, where a few samples are.
        if expected[RADII * SECTORS] < 5.0 && observed[RADII * SECTORS] < 20 {
            observed.pop();
            expected.pop();
        }
        chi_square(&observed, &expected, family).unwrap_or_else(|e| panic!("{tested:?}: {e}"));
        let shifted: Vec<f64> =
            expected.iter().enumerate().map(|(i, e)| if i % 2 == 0 { e * 1.15 } else { e * 0.85 }).collect();
        chi_square(&observed, &shifted, family).expect_err("cells that are 15 % off");

        let values = run(gpu, "evaluated", tested, &directions, directions.len(), false);
        for (s, value) in samples.chunks_exact(2).zip(values.chunks_exact(2)) {
            let expected = f64::from(value[0][0]) / f64::from(s[0][3]);
            // Both are functions of the same f32 direction, computed alike.
            assert!(
                s[0][3] <= 0.0 || (f64::from(s[1][0]) - expected).abs() <= 1e-3 * expected,
                "{tested:?} {s:?} {value:?}"
            );
        }
    }
}
