//! Pass `sample_lights`: the sampled lights estimate the sum over all lights; and the potentials by which lights are
//! sampled.

use std::collections::BTreeSet;

use glam::{DVec3, Vec3};
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::kernels::{GridShape, INVALID_POINT, NO_SAMPLED_LIGHT, ZONE_LIGHTS, compose_source};
use penumbra::internal::passes::grid::{Grid, Photon};
use penumbra::internal::passes::sample_lights::SampleLights;
use penumbra::internal::passes::zones::{ZoneTable, Zones};
use penumbra::internal::passes::{Point, Tile, TileBuffers};
use penumbra::internal::scene::{LightKind, Material, Scene};
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::internal::specialisation::kernels::sorting_grid;
use penumbra::settings::Technique;

use crate::kit::{device_features, new_kernel, published};
use crate::light::{sphere, square};
use crate::octahedral::oct_encode;
use crate::path::{camera, scene, surface};
use crate::random::{Random, RandomInput as _};
use crate::rooms::photon;
use crate::stage::{Stage, whole};
use crate::statistics::{mean_and_error, z_test};
use crate::ward::{Lamp, lit_floor};

const LIGHTS: usize = 90;
const LIGHTS_PER_POINT: u32 = 8;
/// Number of pixels, one more than a workgroup has invocations, and samples per pixel.
const PIXELS: u32 = 65;
const SAMPLES: u32 = 1024;

fn lamps() -> Vec<Lamp> {
    let mut random = Random(21);
    let lamp = |i: usize| {
        let p = random.point();
        let position = DVec3::new(0.5 * p.x, 0.1 + 0.4 * p.y.abs(), 0.1 * p.z).as_vec3().as_dvec3();
        // Powers from one to a hundred; one light emits nothing.
        let intensity =
            if i == 30 { 0.0 } else { f64::from(100f64.powf((i * 37 % LIGHTS) as f64 / LIGHTS as f64) as f32) };
        Lamp { position, intensity }
    };
    let mut lamps: Vec<Lamp> = (0..LIGHTS).map(lamp).collect();
    // Below the floor.
    lamps[5].position.y = -0.3;
    lamps
}

fn room(lamps: &[Lamp]) -> Scene {
    lit_floor(square(DVec3::ZERO, DVec3::Z * 0.1, DVec3::X * 0.5), 0.5, lamps)
}

/// A row of ten zones. Photons are in the second, fifth and eighth zone, so that zones list 3, 40 and more than 64
/// lights, and the last zone none.
fn zones() -> (GridShape, Vec<Photon>) {
    let shape = GridShape { origin: [-0.5, -0.05, -0.1], cell: 0.1, size: [10, 1, 2], inverse_cell: 10.0 };
    let at = |zone: u32| Vec3::new(0.1 * zone as f32 - 0.45, 0.0, 0.0);
    let mut photons = Vec::new();
    for (zone, lights) in [(1, 3), (4, 40), (7, LIGHTS as u32)] {
        for light in 0..lights {
            // The share of illumination photons is 1 to 1/4.
            let shadows = (0..light % 4).map(|_| photon(at(zone), Vec3::Y, light, true));
            photons.extend(std::iter::once(photon(at(zone), Vec3::Y, light, false)).chain(shadows));
        }
    }
    (shape, photons)
}

struct Setup {
    stage: Stage,
    lamps: Vec<Lamp>,
    points: Vec<Point>,
    tile: Tile,
}

impl Setup {
    fn new(gpu: &Gpu, features: impl Fn(Features) -> Features) -> Setup {
        let lamps = lamps();
        let view = camera(DVec3::Z, DVec3::NEG_Z, 1.0);
        let stage = Stage::new(gpu, room(&lamps), &view, [PIXELS, 1], Technique::SHADOW_PHOTONS, features);
        let mut random = Random(8);
        let points = (0..PIXELS).map(|i| {
            let position =
                Vec3::new((f64::from(i) / f64::from(PIXELS) - 0.5) as f32, 0.0, 0.18 * random.uniform() as f32 - 0.09);
            Point { position: position.to_array(), normal: if i == 33 { INVALID_POINT } else { oct_encode(DVec3::Y) } }
        });
        let points = points.flat_map(|point| [point; SAMPLES as usize]).collect();
        let tile = Tile { seed: 4, ..whole([PIXELS, 1], SAMPLES) };
        Setup { stage, lamps, points, tile }
    }

    fn table(&self, gpu: &Gpu) -> (ZoneTable, Vec<u32>) {
        let (gpu, features) = (gpu, sorting_grid(&device_features(gpu)));
        let (shape, photons) = zones();
        let buffer = gpu.upload("test/photons", &photons).unwrap();
        let sorting = Grid::sorting_only(gpu, &features).unwrap();
        let sorted = sorting.sort(gpu, &buffer, photons.len() as u32, 1, shape).unwrap();
        let powers: Vec<f64> = self.lamps.iter().map(|lamp| lamp.intensity).collect();
        let table = Zones::new(gpu, &features).unwrap().list(gpu, &sorted, &powers, false).unwrap();
        let words = gpu.read(&table.lists, (shape.cells() * ZONE_LIGHTS) as usize).unwrap();
        (table, words)
    }

    /// Light and weight of each candidate.
    fn sample(&self, gpu: &Gpu, zones: Option<&ZoneTable>, audited: bool) -> Vec<(u32, f32)> {
        let Stage { features, gpu_scene, .. } = &self.stage;
        let pass = SampleLights::new(gpu, features, &gpu_scene.constants(), LIGHTS_PER_POINT, audited).unwrap();
        let mut buffers = TileBuffers::new(gpu, features, self.tile.point_count, false).unwrap();
        buffers.points = published(gpu, "test/points", &self.points);
        let candidates = (self.tile.point_count * LIGHTS_PER_POINT) as usize;
        let sampled = gpu.poisoned::<[u32; 2]>("test/sampled", candidates).unwrap();
        let bound = pass.bind(gpu, &buffers, &sampled, zones, gpu_scene).unwrap();
        let mut frame = gpu.frame("test");
        bound.record(&mut frame, &self.tile);
        frame.submit().unwrap();
        let candidates: Vec<[u32; 2]> = gpu.read(&sampled, candidates).unwrap();
        candidates.into_iter().map(|[light, weight]| (light, f32::from_bits(weight))).collect()
    }

    /// The candidates of one sample of a pixel.
    fn candidates(&self, sampled: &[(u32, f32)], pixel: u32, sample: u32) -> Vec<(u32, f32)> {
        let at = |index: u32| sampled[(index * self.tile.point_count + pixel * SAMPLES + sample) as usize];
        (0..LIGHTS_PER_POINT).map(at).collect()
    }

    fn point(&self, pixel: u32) -> Point {
        self.points[(pixel * SAMPLES) as usize]
    }

    fn irradiance(&self, pixel: u32, light: usize) -> f64 {
        let Lamp { position, intensity } = self.lamps[light];
        let offset = position - Vec3::from(self.point(pixel).position).as_dvec3();
        intensity * offset.y.max(0.0) / offset.length().powi(3)
    }

    /// Whether the mean over the samples of the weighted lights that are `visible` equals their sum over `within`.
    fn sums_up(
        &self,
        sampled: &[(u32, f32)],
        pixel: u32,
        visible: impl Fn(usize) -> bool,
        within: impl Fn(usize) -> bool,
    ) -> Result<(), String> {
        let of = |light: usize| if visible(light) { self.irradiance(pixel, light) } else { 0.0 };
        let exact: f64 = (0..LIGHTS).filter(|light| within(*light)).map(of).sum();
        let estimate = |sample: u32| -> f64 {
            let candidates = self.candidates(sampled, pixel, sample);
            candidates
                .iter()
                .filter(|(light, _)| *light != NO_SAMPLED_LIGHT)
                .map(|(light, w)| f64::from(*w) * of(*light as usize))
                .sum()
        };
        let all: Vec<f64> = (0..SAMPLES).map(estimate).collect();
        let (mean, error) = mean_and_error(all.iter().copied());
        // Without noise, the rounding of floats.
        z_test(mean, error.max(1e-5 * exact.max(1e-9)), exact, 4 * PIXELS).map_err(|e| format!("pixel {pixel}: {e}"))
    }
}

/// By zones: the mean over a point's samples is the sum over all lights, whichever lights are visible; without audits,
/// the sum over the lights that the zone lists. No light is sampled twice, each has a probability of at most one, and
/// all lights of a short list are sampled. An error of an eighth in a weight is detected.
#[kernel_test("PENUMBRA_DEVICE")]
fn lights_sampled_by_zone_estimate_all(gpu: &Gpu) {
    let setup = Setup::new(gpu, |features| features);
    assert!(setup.stage.features.has(Feature::Zones));
    let (table, lists) = setup.table(gpu);
    let (shape, _) = zones();
    let list = |pixel: u32| -> BTreeSet<usize> {
        let position = Vec3::from(setup.point(pixel).position);
        let cell = |axis: usize| ((position[axis] - shape.origin[axis]) * shape.inverse_cell).floor() as u32;
        let zone = (cell(2) * shape.size[1] + cell(1)) * shape.size[0] + cell(0);
        let words = &lists[(zone * ZONE_LIGHTS) as usize..][..ZONE_LIGHTS as usize];
        words.iter().filter(|word| **word != 0).map(|word| (word & 0xffff) as usize).collect()
    };
    let lengths: BTreeSet<usize> = (0..PIXELS).map(|pixel| list(pixel).len()).collect();
    assert_eq!(lengths, BTreeSet::from([0, 3, 40, 64]));
    let every = |_: usize| true;
    let odd = |light: usize| light % 3 == 1;
    for audited in [true, false] {
        let sampled = setup.sample(gpu, Some(&table), audited);
        let wrong: Vec<(u32, f32)> = sampled.iter().map(|(light, w)| (*light, w * 0.875)).collect();
        let (mut caught, mut zones) = (0, 0);
        for pixel in 0..PIXELS {
            if pixel == 33 {
                assert!(
                    (0..SAMPLES).all(|s| setup
                        .candidates(&sampled, pixel, s)
                        .iter()
                        .all(|(light, _)| *light == NO_SAMPLED_LIGHT))
                );
                continue;
            }
            let listed = list(pixel);
            let picks = (LIGHTS_PER_POINT - u32::from(audited)) as usize;
            let reaching = listed.iter().filter(|light| setup.irradiance(pixel, **light) > 0.0).count();
            for sample in 0..SAMPLES {
                let candidates = setup.candidates(&sampled, pixel, sample);
                let lights: Vec<usize> = candidates
                    .iter()
                    .filter(|(light, _)| *light != NO_SAMPLED_LIGHT)
                    .map(|(light, _)| *light as usize)
                    .collect();
                let what = format!("pixel {pixel}, sample {sample}: {candidates:?}");
                assert_eq!(lights.iter().collect::<BTreeSet<_>>().len(), lights.len(), "{what}");
                let of_list = candidates.iter().filter(|(light, _)| listed.contains(&(*light as usize)));
                assert!(of_list.clone().all(|(_, weight)| *weight >= 1.0), "{what}");
                assert!(of_list.clone().count() <= picks, "{what}");
                assert!(lights.len() - of_list.clone().count() <= usize::from(audited), "{what}");
                if reaching <= picks {
                    assert!(of_list.clone().count() == reaching && of_list.clone().all(|(_, w)| *w == 1.0), "{what}");
                }
            }
            let within = |light: usize| audited || listed.contains(&light);
            setup.sums_up(&sampled, pixel, every, within).unwrap();
            setup.sums_up(&sampled, pixel, odd, within).unwrap();
            caught += u32::from(setup.sums_up(&wrong, pixel, every, within).is_err());
            zones += u32::from(!listed.is_empty() || audited);
        }
        println!("audited {audited}: an eighth is detected at {caught} of {zones} points");
        assert!(caught * 10 > zones * 9, "an eighth is detected at {caught} of {zones} points");
    }
}

/// By power, uniformly and by contribution: the mean is the sum over all lights, and no light is sampled twice. What a
/// light sends counts, not its power: by contribution every sample finds the same light, up to the roundings of the
/// potentials.
#[kernel_test("PENUMBRA_DEVICE")]
fn lights_sampled_from_all_estimate_all(gpu: &Gpu) {
    for sampling in [None, Some(Feature::UniformLightSampling), Some(Feature::ContributionSampling)] {
        let setup = Setup::new(gpu, |features| {
            let features = features.with(Feature::Zones, false);
            sampling.into_iter().fold(features, |features, feature| features.with(feature, true))
        });
        let sampled = setup.sample(gpu, None, false);
        let wrong: Vec<(u32, f32)> = sampled.iter().map(|(light, w)| (*light, w * 0.75)).collect();
        let mut caught = 0;
        for pixel in (0..PIXELS).filter(|pixel| *pixel != 33) {
            for sample in 0..SAMPLES {
                let candidates = setup.candidates(&sampled, pixel, sample);
                let lights = candidates.iter().filter(|(light, _)| *light != NO_SAMPLED_LIGHT).map(|(light, _)| light);
                assert_eq!(lights.clone().collect::<BTreeSet<_>>().len(), lights.count(), "{candidates:?}");
            }
            setup.sums_up(&sampled, pixel, |_| true, |_| true).unwrap();
            caught += u32::from(setup.sums_up(&wrong, pixel, |_| true, |_| true).is_err());
        }
        println!("{sampling:?}: a quarter is detected at {caught} points");
        assert!(caught > PIXELS / 2, "a quarter is detected at {caught} points");
    }
}

/// The potential of a light is positive wherever the light is not dark. For small lights that are not at the horizon,
/// it is the irradiance in a unit common to all lights.
#[kernel_test("PENUMBRA_DEVICE")]
fn potentials_are_irradiances(gpu: &Gpu) {
    let panel = |at: DVec3, half: f64| square(at, DVec3::X * half, DVec3::Z * half);
    let double_sided = |material: Material| Material { double_sided: true, ..material };
    let meshes = [
        (square(DVec3::ZERO, DVec3::Z * 0.5, DVec3::X * 0.5), surface(0.5, 0.0)),
        (panel(DVec3::new(0.1, 0.4, 0.0), 0.002), surface(0.0, 400.0)),
        (panel(DVec3::new(-0.1, 0.3, 0.1), 0.2), surface(0.0, 2.0)),
        (panel(DVec3::new(-0.3, 0.4, 0.1), 0.01), double_sided(surface(0.0, 50.0))),
        (sphere(DVec3::new(0.3, 0.45, 0.2), 0.05, 3), surface(0.0, 20.0)),
        // Lights in front of parts of which the centre of their box lies: a panel that is not symmetric, and two panels
        // at different heights.
        (vec![[DVec3::X * 0.3, DVec3::Y * 0.3, DVec3::Z * 0.3]], surface(0.0, 2.0)),
        ([panel(DVec3::new(0.2, 0.4, 0.1), 0.03), panel(DVec3::new(0.4, 0.1, 0.1), 0.03)].concat(), surface(0.0, 9.0)),
    ];
    let (range, intensity) = (f32::INFINITY, Vec3::splat(0.2));
    let punctual = vec![
        LightKind::Point { position: Vec3::new(0.0, 0.35, -0.2), intensity, range },
        LightKind::Spot {
            position: Vec3::new(0.2, 0.45, 0.1),
            direction: Vec3::NEG_Y,
            intensity,
            cos_inner: 0.9,
            cos_outer: 0.5,
            range,
        },
        LightKind::Directional { direction: Vec3::new(0.6, -0.8, 0.0), irradiance: Vec3::ONE },
    ];
    let view = camera(DVec3::Z, DVec3::NEG_Z, 1.0);
    let stage = Stage::new(gpu, scene(&meshes, punctual), &view, [8, 8], Technique::TWO_PASS, |features| features);
    let mut random = Random(2);
    let lights = stage.scene.lights.len();
    const QUERIES: usize = 4000;
    let queries: Vec<[[f32; 4]; 2]> = (0..QUERIES)
        .map(|i| {
            let position = (random.point() * 0.5).as_vec3();
            // Some are exactly in the plane of a panel.
            let position = if i % 50 == 1 { position.with_y(0.4) } else { position };
            let normal = random.direction().as_vec3();
            [position.extend((i % lights) as f32).to_array(), normal.extend(0.0).to_array()]
        })
        .collect();
    let source = include_str!("shaders/potential.wgsl");
    let composed = compose_source("potential", source, &stage.features).unwrap();
    let kernel = new_kernel(gpu, &composed, &[("count", QUERIES as f64)], &["queries", "results"]).unwrap();
    let (input, output) =
        (gpu.upload("test/queries", &queries).unwrap(), gpu.poisoned::<[f32; 4]>("test/results", QUERIES).unwrap());
    let own = Resources::new().with("queries", &input).with("results", &output);
    let bound = kernel.bind(gpu, "weigh", &[&own, &stage.gpu_scene]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, QUERIES as u32, &[0u32; 0]);
    frame.submit().unwrap();
    let results: Vec<[f32; 4]> = gpu.read(&output, QUERIES).unwrap();
    let mut ratios: Vec<Vec<f64>> = vec![Vec::new(); lights];
    let mut positive = 0;
    for (query, [potential, irradiance, dark, _]) in queries.iter().zip(&results) {
        let light = query[0][3] as usize;
        let [position, normal] = query.map(|v| Vec3::from_slice(&v).as_dvec3());
        let info = &stage.gpu_scene.lights.lights[light];
        if *dark == 0.0 && (*irradiance > 0.0 || !info.closed_form) {
            assert!(*potential > 0.0, "light {light} from {position} facing {normal}: {irradiance}");
            positive += 1;
        }
        let offset = match stage.scene.lights[light].kind {
            LightKind::Directional { direction, .. } => -direction.as_dvec3(),
            _ => info.centre.as_dvec3() - position,
        };
        let cosine = offset.normalize().dot(normal);
        let far = info.punctual || offset.length() > 40.0 * f64::from(info.radius);
        let before = info.emission.axis.is_none_or(|axis| -axis.as_dvec3().dot(offset.normalize()) > 0.1);
        if info.closed_form && !info.two_sided && far && before && *irradiance > 0.0 && cosine > 0.25 {
            ratios[light].push(f64::from(*potential) / f64::from(*irradiance));
        }
    }
    println!("{positive} points that lights reach; {:?}", ratios.iter().map(Vec::len).collect::<Vec<_>>());
    // A guard: many queries have light.
    assert!(positive > 1000);
    let all: Vec<f64> = ratios.iter().flatten().copied().collect();
    let (smallest, largest) = all.iter().fold((f64::MAX, 0.0f64), |(a, b), r| (a.min(*r), b.max(*r)));
    println!("{smallest} to {largest} of {}", all.len());
    // The potential treats a light as if all of it were at its nearest point: an error of a radius of 1/40 of the
    // distance, over a cosine of 1/4.
    assert!(all.len() > 300 && largest < 1.12 * smallest, "{smallest} to {largest}");
}
