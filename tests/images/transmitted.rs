//! Light that passes through surfaces: diffusely, by wavelength, and within volumes of other objects.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3, Vec4};
use penumbra::internal::scene::{
    DiffuseTransmission, Dispersion, LightKind, Material, Medium, Panorama, Specular, Transmission, Volume,
};
use penumbra::{Aov, Scene, Settings, Technique};

use crate::meshes::{Corners, camera, cube, panorama, scene, sphere, square, surface};
use crate::setup::{assert_same, deviation, mean_and_error, render_scene};

fn settings(technique: Technique, spp: u32) -> Settings {
    Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = 32;
        s.image.height = 32;
        s.image.spp = spp;
        s.image.aovs = vec![Aov::Variance];
        s.indirect.photons = Some(1 << 15);
    })
}

fn under(meshes: &[(Vec<Corners>, Material)], panorama: &Panorama) -> Scene {
    let mut scene = scene(meshes, Vec::new());
    scene.set_environment(Arc::new(panorama.clone()), 0.0, 1.0).unwrap();
    scene
}

fn leaf(albedo: f32, factor: f32, colour: Vec3) -> Material {
    Material { diffuse_transmission: DiffuseTransmission::new(factor, colour), ..surface(albedo, 0.0) }
}

/// A leaf of albedo a, factor f and colour c between a sky of radiance L and a dark ground has the radiance
/// a (1 - f) L from above, and c f L from below, by every technique.
#[test]
fn leaves_show_the_light_behind_them() {
    let sky = panorama(64, 32, |d| DVec3::splat(if d.y > 0.0 { 2.0 } else { 0.0 }));
    let sheet = [(square(DVec3::ZERO, DVec3::Z * 0.6, DVec3::X * 0.6), leaf(0.5, 0.4, Vec3::new(0.9, 0.6, 0.3)))];
    for technique in Technique::all() {
        for (side, expected) in [(0.5, [0.6; 3]), (-0.5, [0.72, 0.48, 0.24])] {
            let view = camera(DVec3::new(0.0, side, 0.0), DVec3::new(0.0, -side, 0.0), 0.5);
            let (image, statistics) = render_scene(under(&sheet, &sky), &view, &settings(technique, 32));
            for (channel, expected) in ["R", "G", "B"].into_iter().zip(expected) {
                let (mean, error) = mean_and_error(&image, channel);
                // Interpolation between sky and ground: half a row of 32 at cosines of as much. Shown maps have their
                // own error.
                let tolerance = if technique.shows_map() { 0.02 } else { 0.003 };
                // By chance, 3.5 standard errors are exceeded once in 2,000 times.
                let off = |mean: f64| (mean - expected).abs() / (3.5 * error + tolerance * expected);
                assert!(off(mean) < 1.0, "{technique}, {channel} from {side}: {mean} +- {error}, not {expected}");
                assert!(off(1.1 * mean) > 1.0, "{technique}, {channel} from {side}: 10 % more would pass");
            }
            assert_eq!(statistics.not_finite, 0);
        }
    }
}

/// Without bounces, a leaf shows the light of a lamp behind it that has no size: its radiance is c / pi times the
/// irradiance. Two-pass techniques had none, because no ray can hit such a lamp.
#[test]
fn leaves_show_lamps_without_a_size_behind_them() {
    let colour = Vec3::new(0.9, 0.6, 0.3);
    let lamp = LightKind::Point { position: Vec3::Y, intensity: Vec3::ONE, range: f32::INFINITY };
    let sheet = [(square(DVec3::ZERO, DVec3::Z * 0.6, DVec3::X * 0.6), leaf(0.5, 1.0, colour))];
    let (distance, angle) = (0.5, 0.5f32);
    let view = camera(DVec3::NEG_Y * distance, DVec3::Y, angle);
    // The mean irradiance of what is seen, by the midpoint rule.
    let at = |i: i32| distance * f64::from(angle / 2.0).tan() * (f64::from(2 * i + 1) / 64.0 - 1.0);
    let irradiance = |i: i32| (at(i % 64).powi(2) + at(i / 64).powi(2) + 1.0).powf(-1.5);
    let mean_irradiance = (0..64 * 64).map(irradiance).sum::<f64>() / f64::from(64 * 64);
    for technique in Technique::all().filter(|technique| !technique.shows_map()) {
        let settings = settings(technique, 16).with(|s| s.indirect.max_bounces = 0);
        let (image, _) = render_scene(scene(&sheet, vec![lamp.clone()]), &view, &settings);
        for (channel, colour) in ["R", "G", "B"].into_iter().zip(colour.to_array()) {
            let expected = f64::from(colour) / PI * mean_irradiance;
            let (mean, error) = mean_and_error(&image, channel);
            // 16,000 stratified samples of a function that varies by a tenth.
            // By chance, 3.5 standard errors are exceeded once in 2,000 times.
            let off = |mean: f64| (mean - expected).abs() / (3.5 * error + 1e-3 * expected);
            assert!(off(mean) < 1.0, "{technique}, {channel}: {mean} +- {error}, not {expected}");
            assert!(off(1.02 * mean) > 1.0, "{technique}, {channel}: 2 % more would pass");
        }
    }
}

/// A volume behind a surface that lets no light pass has no effect, whatever else the scene has: rays that meet the
/// back of an opaque bowl were absorbed as soon as any other material was glass.
#[test]
fn volumes_behind_opaque_surfaces_have_no_effect() {
    let volume = Volume { attenuation_distance: 0.1, attenuation_colour: Vec3::splat(0.1) };
    let pane = square(DVec3::new(0.0, 0.3, 0.0), DVec3::X * 0.2, DVec3::NEG_Z * 0.2);
    let lamp = LightKind::Point { position: Vec3::new(0.2, 0.6, 0.1), intensity: Vec3::ONE, range: f32::INFINITY };
    let view = camera(DVec3::new(0.0, 0.6, 0.6), DVec3::new(0.0, -0.6, -0.6), 0.8);
    for technique in [Technique::PATH, Technique::SHADOW_PHOTONS] {
        let of = |volume: Option<Volume>| {
            let room = Material { volume, double_sided: true, ..surface(0.7, 0.0) };
            let meshes = [(cube(DVec3::ZERO, 1.0), room), (pane.clone(), glass(1.5, 0.0))];
            render_scene(scene(&meshes, vec![lamp.clone()]), &view, &settings(technique, 4)).0
        };
        let [without, with] = [None, Some(volume)].map(of);
        assert!(mean_and_error(&without, "G").0 > 0.01, "{technique}: nothing is lit");
        assert_same(&with, &without, &technique.to_string());
    }
}

/// No glass shines brighter than the furnace around it, whatever part of it is a diffuse base: light that is reflected
/// totally inside reaches no base. A base that ignored this would add light at each reflection, without bound.
#[test]
fn glass_with_a_diffuse_base_makes_no_light() {
    let white = panorama(8, 4, |_| DVec3::ONE);
    let view = camera(DVec3::new(0.0, 0.0, 1.6), DVec3::NEG_Z, 0.6);
    for (factor, roughness) in [(0.1, 0.2), (0.5, 0.0), (0.5, 0.4), (0.9, 0.2)] {
        let (transmission, base_colour) = (Transmission::with_factor(factor), surface(0.8, 0.0).base_colour);
        let partly = Material { transmission, base_colour, roughness, ..glass(1.5, 0.0) };
        for technique in [Technique::PATH, Technique::TWO_PASS] {
            let ball = [(sphere(DVec3::ZERO, 0.4, 24), partly.clone())];
            let (image, _) = render_scene(under(&ball, &white), &view, &settings(technique, 32));
            let (mean, error) = mean_and_error(&image, "G");
            println!("{technique}, factor {factor}, roughness {roughness}: {mean} +- {error}");
            // The ball covers a half of the view, and returns at least a third of the light.
            assert!(error < 0.01 && (0.6..1.0 + 3.0 * error).contains(&mean), "{technique}: {mean} +- {error}");
            // A path adds at most 1 where weights of samples are bounded by the lobes' chances.
            let brightest = image.channel("G").unwrap().iter().fold(0f32, |max, x| max.max(*x));
            assert!(brightest < 1.2, "{technique}, factor {factor}: {brightest}");
        }
    }
}

/// A lamp over a leaf over a floor: what shadow photons, final gathering and caustics make of the light that the leaf
/// scatters is what paths find.
#[test]
fn leaves_light_the_floor_below() {
    let lamp = square(DVec3::Y * 0.8, DVec3::X * 0.2, DVec3::Z * 0.2);
    let middle = square(DVec3::Y * 0.3, DVec3::Z * 0.3, DVec3::X * 0.3);
    let floor = square(DVec3::ZERO, DVec3::Z * 0.6, DVec3::X * 0.6);
    let meshes = [(floor, surface(0.7, 0.0)), (middle, leaf(0.4, 0.7, Vec3::ONE)), (lamp, surface(0.0, 8.0))];
    let view = camera(DVec3::new(0.0, 0.25, 1.2), DVec3::new(0.0, -0.15, -1.2), 0.6);
    let mean = |technique: Technique| {
        let (image, _) = render_scene(scene(&meshes, Vec::new()), &view, &settings(technique, 256));
        mean_and_error(&image, "G")
    };
    let reference = mean(Technique::PATH);
    for technique in [Technique::SHADOW_PHOTONS, Technique::TWO_PASS] {
        let found = mean(technique);
        println!("{technique}: {found:?}, paths {reference:?}");
        // Final gathering has an error of 0.5 % by itself.
        // By chance, 3.5 standard errors are exceeded once in 2,000 times.
        let allowed = 3.5 + 0.005 * reference.0 / reference.1.hypot(found.1);
        assert!(deviation(found, reference) < allowed, "{technique}: {found:?}, not {reference:?}");
    }
    // An opaque leaf would be seen.
    let opaque = [meshes[0].clone(), (meshes[1].0.clone(), surface(0.12, 0.0)), meshes[2].clone()];
    let (image, _) = render_scene(scene(&opaque, Vec::new()), &view, &settings(Technique::PATH, 64));
    assert!(mean_and_error(&image, "G").0 < 0.9 * reference.0);
}

/// Photons pass a leaf or a rough pane with bent normals as paths do. Paths that arrive from below, behind the bent
/// normal, see it bent towards them. Without this part of the directions, photons had 7 % less light behind the leaf.
#[test]
fn photons_pass_bent_normals_as_paths_do() {
    let bend = 50f64.to_radians();
    let bent = DVec3::new(bend.sin(), bend.cos(), 0.0).as_vec3();
    let lamp = (square(DVec3::Y * 0.8, DVec3::X * 0.2, DVec3::Z * 0.2), surface(0.0, 8.0));
    let floor = (square(DVec3::ZERO, DVec3::Z * 0.6, DVec3::X * 0.6), surface(0.7, 0.0));
    let pane = Material { transmission: Transmission::with_factor(1.0), roughness: 0.7, ..surface(0.9, 0.0) };
    for material in [leaf(0.4, 0.7, Vec3::ONE), pane] {
        let middle = (square(DVec3::Y * 0.4, DVec3::Z * 0.6, DVec3::X * 0.6), material);
        let of = |technique: Technique, spp: u32| {
            let mut scene = scene(&[middle.clone(), floor.clone(), lamp.clone()], Vec::new());
            for triangle in scene.triangles.iter().filter(|triangle| triangle.material == 0) {
                for vertex in triangle.vertices {
                    Arc::make_mut(&mut scene.vertices)[vertex as usize].normal = bent;
                }
            }
            // From below the middle, the light's only bounce.
            let view = camera(DVec3::Y * 0.3, DVec3::NEG_Y, 0.8);
            let settings = settings(technique, spp).with(|s| {
                s.indirect.max_bounces = 1;
                s.indirect.photons = Some(1 << 18);
            });
            mean_and_error(&render_scene(scene, &view, &settings).0, "G").0
        };
        let (paths, photons) = (of(Technique::PATH, 256), of(Technique::PHOTON_MAP, 16));
        println!("{photons} by photons, {paths} by paths");
        // The noise of 20,000 photons on the visible floor and of the probes of their discs.
        assert!((photons / paths - 1.0).abs() < 0.03, "{photons} by photons, {paths} by paths");
    }
}

fn glass(ior: f32, strength: f32) -> Material {
    Material {
        roughness: 0.0,
        ior,
        specular: Specular::with_factor(1.0),
        transmission: Transmission::with_factor(1.0),
        volume: Some(Volume { attenuation_distance: f32::INFINITY, attenuation_colour: Vec3::ONE }),
        dispersion: Dispersion::new(strength),
        ..surface(1.0, 0.0)
    }
}

/// A ball of glass with strong dispersion under a uniform sky has the sky's radiance, in all three colours: each
/// wavelength is a third of the paths with three times the light. With 3 n samples each wavelength has the same number.
#[test]
fn dispersion_makes_no_light_and_no_colour() {
    let even = panorama(8, 4, |_| DVec3::ONE);
    let ball = [(sphere(DVec3::ZERO, 0.3, 24), glass(1.5, 2.0))];
    let view = camera(DVec3::new(0.0, 0.0, 0.9), DVec3::NEG_Z, 0.5);
    for technique in [Technique::PATH, Technique::SHADOW_PHOTONS] {
        let (image, _) = render_scene(under(&ball, &even), &view, &settings(technique, 96));
        for channel in ["R", "G", "B"] {
            let (mean, error) = mean_and_error(&image, channel);
            // Paths end after the maximum number of bounces; specular chains after 32 links.
            // By chance, 3.5 standard errors are exceeded once in 2,000 times.
            assert!((mean - 1.0).abs() < 3.5 * error + 0.004, "{technique}, {channel}: {mean} +- {error}");
        }
    }
}

/// A prism bends each colour by its own index of refraction: where the camera sees an edge through it follows from
/// Snell's law in f64.
#[test]
fn prisms_bend_colours_by_their_own_indices() {
    const SLOPE: f64 = 0.4;
    const WIDE: f64 = 0.5;
    // A wedge whose front is the plane z = 0 and whose back is z = -0.1 - SLOPE (x + WIDE).
    let at = |x: f64, y: f64, back: bool| DVec3::new(x, y, if back { -0.1 - SLOPE * (x + WIDE) } else { 0.0 });
    let corner = |i: usize| {
        let side = |bit: usize| if i >> bit & 1 == 1 { WIDE } else { -WIDE };
        at(side(0), side(1), i >> 2 & 1 == 1)
    };
    let quads = [[0, 1, 3, 2], [5, 4, 6, 7], [4, 0, 2, 6], [1, 5, 7, 3], [4, 5, 1, 0], [2, 3, 7, 6]];
    let wedge: Vec<Corners> =
        quads.iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).map(|t| t.map(|i| corner(*i))).collect();
    let (ior, strength) = (1.6, 2.0);
    // The refracted direction in the plane y = 0, of one from the camera with the slope x over -z.
    let out = |slope: f64, index: f64| {
        let refract = |d: DVec2, n: DVec2, eta: f64| {
            let cosine = -d.dot(n);
            let k = 1.0 - eta * eta * (1.0 - cosine * cosine);
            eta * d + (eta * cosine - k.sqrt()) * n
        };
        let inside = refract(DVec2::new(slope, -1.0).normalize(), DVec2::Y, 1.0 / index);
        refract(inside, DVec2::new(SLOPE, 1.0).normalize(), index)
    };
    let spread = 0.025 * strength * (ior - 1.0);
    let indices = [ior - spread, ior, ior + spread];
    // The edge is where green is seen in the middle of the image; white lies on the side of larger x.
    let middle = out(0.0, ior);
    let edge = middle.x.atan2(-middle.y);
    let sky = panorama(4096, 16, |d| DVec3::splat(if d.z < 0.0 && d.x.atan2(-d.z) > edge { 1.0 } else { 0.0 }));
    let glass = glass(ior as f32, strength as f32);
    let half = 0.1f64;
    let view = camera(DVec3::new(0.0, 0.0, 1.0), DVec3::NEG_Z, 2.0 * half.atan() as f32);
    let (image, _) = render_scene(under(&[(wedge, glass)], &sky), &view, &settings(Technique::PATH, 192));
    let mut shares = Vec::new();
    for (channel, index) in ["R", "G", "B"].into_iter().zip(indices) {
        // The slope at which that colour meets the edge, by bisection; the colour's share of the image is beyond it.
        let (mut low, mut high) = (-0.3, 0.3);
        for _ in 0..60 {
            let slope = 0.5 * (low + high);
            let d = out(slope, index);
            if d.x.atan2(-d.y) > edge { high = slope } else { low = slope }
        }
        let expected = (half - low) / (2.0 * half);
        let samples = image.channel(channel).unwrap();
        let brightest = samples.iter().copied().fold(0.0, f32::max);
        // Both faces reflect a twentieth of the light each; the brightest pixels see white alone.
        assert!((0.8..1.6).contains(&brightest), "{channel}: {brightest}");
        let columns = (0..32).map(|x| (0..32).map(|y| f64::from(samples[y * 32 + x])).sum::<f64>() / 32.0);
        let columns: Vec<f64> = columns.collect();
        let white = columns.iter().rev().take(4).sum::<f64>() / 4.0;
        let share = columns.iter().sum::<f64>() / 32.0 / white;
        println!("{channel}: {share}, expected {expected}");
        // The texels of the panorama are 0.0015 wide, the image 0.2.
        assert!((share - expected).abs() < 0.02, "{channel}: {share} of the image, not {expected}");
        shares.push(expected);
    }
    assert!(shares[2] - shares[0] > 0.1, "the colours are hardly apart: {shares:?}");
    assert!(edge.abs() < TAU / 8.0);
}

/// A ball of water in water is invisible, and an object in an absorbing volume loses light on the way.
#[test]
fn volumes_within_volumes() {
    let even = panorama(64, 32, |d| DVec3::splat(1.0 + d.x));
    let volume = |distance: f32| Volume { attenuation_distance: distance, attenuation_colour: Vec3::splat(0.5) };
    let water = Material { volume: Some(volume(0.5)), ..glass(1.33, 0.0) };
    let within = |m: Material| Material { medium: Some(Medium { ior: 1.33, volume: volume(0.5) }), ..m };
    let tank = || (cube(DVec3::ZERO, 0.5), water.clone());
    let view = camera(DVec3::new(0.0, 0.0, 1.5), DVec3::NEG_Z, 0.4);
    let image = |meshes: &[(Vec<Corners>, Material)]| {
        let (image, _) = render_scene(under(meshes, &even), &view, &settings(Technique::PATH, 64));
        mean_and_error(&image, "G")
    };
    let (empty, filled) = (image(&[tank()]), image(&[tank(), (sphere(DVec3::ZERO, 0.2, 12), within(water.clone()))]));
    assert!(deviation(empty, filled) < 3.5 || (empty.0 - filled.0).abs() < 2e-3 * empty.0, "{empty:?} {filled:?}");
    // By itself, without the water around, it bends light.
    let alone = image(&[tank(), (sphere(DVec3::ZERO, 0.2, 12), water.clone())]);
    assert!((alone.0 - empty.0).abs() > 2e-3 * empty.0 && deviation(alone, empty) > 3.5, "{alone:?} {empty:?}");

    // A shining plate at depth d in a volume that does not bend light: half is left after each attenuation distance.
    let plate = Material { unlit: true, ..surface(1.0, 0.0) };
    let clear = Material { ior: 1.0, volume: Some(volume(0.25)), ..glass(1.0, 0.0) };
    let medium = Medium { ior: 1.0, volume: volume(0.25) };
    let square = square(DVec3::ZERO, DVec3::X * 0.4, DVec3::Y * 0.4);
    let plate = (square, Material { medium: Some(medium), ..plate });
    let narrow = camera(DVec3::new(0.0, 0.0, 1.5), DVec3::NEG_Z, 0.02);
    let meshes = [(cube(DVec3::ZERO, 0.5), clear), plate];
    for technique in [Technique::PATH, Technique::TWO_PASS] {
        let (rendered, _) = render_scene(under(&meshes, &even), &narrow, &settings(technique, 16));
        let (mean, _) = mean_and_error(&rendered, "G");
        // 0.5 deep, which is two distances.
        assert!((mean - 0.25).abs() < 1e-3, "{technique}: {mean}");
    }
}

/// Lamps count as outside of volumes: the light of a lamp in coloured glass that neither bends nor reflects is that of
/// the bare lamp, for photons as for paths. The tolerance is 1 %, for the density estimate of the caustic map, plus 3.5
/// standard errors. With absorption on the way out of the glass the photons brought less than half of the light.
#[test]
fn lamps_in_coloured_glass_are_not_absorbed() {
    let floor = || (square(DVec3::ZERO, DVec3::X, DVec3::NEG_Z), surface(0.5, 0.0));
    let lamp = || (cube(DVec3::Y * 0.6, 0.15), surface(0.0, 10.0));
    let volume = |distance: f32| Volume { attenuation_distance: distance, attenuation_colour: Vec3::splat(0.5) };
    let clear = |distance| Material {
        ior: 1.0,
        specular: Specular::with_factor(0.0),
        volume: Some(volume(distance)),
        ..glass(1.0, 0.0)
    };
    let view = camera(DVec3::new(0.0, 0.3, 0.0), DVec3::NEG_Y, 0.8);
    let of = |technique, spp, meshes: &[(Vec<Corners>, Material)]| {
        let settings = settings(technique, spp).with(|s| s.indirect.max_bounces = 4);
        let (image, statistics) = render_scene(scene(meshes, Vec::new()), &view, &settings);
        (mean_and_error(&image, "G"), statistics.indirect.caustics)
    };
    let (bare, _) = of(Technique::TWO_PASS, 32, &[floor(), lamp()]);
    let within = |distance| [floor(), lamp(), (cube(DVec3::Y * 0.6, 0.2), clear(distance))];
    let off = |found: (f64, f64)| (found.0 - bare.0).abs() / (0.01 * bare.0 + 3.5 * found.1.hypot(bare.1));
    let (paths, _) = of(Technique::PATH, 512, &within(0.05));
    assert!(off(paths) < 1.0, "{paths:?} by paths, {bare:?} of the bare lamp");
    for technique in [Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
        let (photons, caustics) = of(technique, 32, &within(0.05));
        println!("{photons:?} by {technique}, {paths:?} by paths, {bare:?} of the bare lamp");
        assert!(caustics > 1000, "{caustics} photons in the caustic map");
        assert!(off(photons) < 1.0, "{photons:?} by {technique}, {bare:?} of the bare lamp");
        assert!(off((1.05 * photons.0, photons.1)) > 1.0, "5 % more would pass");
    }
}

/// A lamp that is a volume itself absorbs the light that it emits inwards: a plate in the middle of a shining cube has
/// the mean of exp(-sigma d) over all directions, times its albedo, for the distances d to the cube's faces.
/// When only rays that hit the cube were absorbed, and not light points on it, green was 1.24 times as bright by paths.
#[test]
fn lamps_absorb_the_light_that_they_emit_inwards() {
    let distance = 0.5;
    let volume = Volume { attenuation_distance: distance, attenuation_colour: Vec3::new(1.0, 0.5, 0.1) };
    let shell = Material {
        ior: 1.0,
        specular: Specular::with_factor(0.0),
        volume: Some(volume),
        double_sided: true,
        emissive: Vec3::ONE,
        ..glass(1.0, 0.0)
    };
    let plate = square(DVec3::ZERO, DVec3::X * 0.2, DVec3::NEG_Z * 0.2);
    let scene = scene(&[(plate, surface(0.5, 0.0)), (cube(DVec3::ZERO, 0.5), shell)], Vec::new());
    let (height, angle) = (0.3, 0.5f32);
    let view = camera(DVec3::Y * height, DVec3::NEG_Y, angle);
    // The mean over 5 x 5 places of what is seen, and over directions with a density in proportion to the cosine.
    const SIDE: u32 = 64;
    let seen = height * f64::from(angle / 2.0).tan();
    let mean = |colour: f32| {
        let of = |i: u32| {
            let at = |k: u32, side: u32| (f64::from(k % side) + 0.5) / f64::from(side);
            let [u, v] = [at(i, SIDE), at(i / SIDE, SIDE)];
            let place = seen * (2.0 * DVec2::new(at(i / SIDE / SIDE, 5), at(i / SIDE / SIDE / 5, 5)) - 1.0);
            let (sine, cosine) = (u.sqrt(), (1.0 - u).sqrt());
            let way = DVec3::new(sine * (TAU * v).cos(), cosine, sine * (TAU * v).sin());
            let to_faces = (0.5 * way.signum() - DVec3::new(place.x, 0.0, place.y)) / way;
            f64::from(colour).powf(to_faces.min_element() / f64::from(distance))
        };
        (0..25 * SIDE * SIDE).map(of).sum::<f64>() / f64::from(25 * SIDE * SIDE)
    };
    for technique in [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS, Technique::PHOTON_MAP] {
        // Of these, 2,000 lie on what is seen of the plate.
        let photons = if technique.shows_map() { 1 << 20 } else { 1 << 12 };
        let settings = settings(technique, 64).with(|s| s.indirect.photons = Some(photons));
        let (image, _) = render_scene(scene.clone(), &view, &settings);
        for (channel, colour) in ["R", "G", "B"].into_iter().zip(volume.attenuation_colour.to_array()) {
            let expected = 0.5 * mean(colour);
            let (found, error) = mean_and_error(&image, channel);
            // 2,000 independent photons have a noise of 2.2 %, those of a Sobol sequence less.
            let tolerance = if technique.shows_map() { 0.03 } else { 0.002 };
            // By chance, 3.5 standard errors are exceeded once in 2,000 times.
            let off = |found: f64| (found - expected).abs() / (3.5 * error + tolerance * expected);
            println!("{technique}, {channel}: {found} +- {error}, expected {expected}");
            assert!(off(found) < 1.0, "{technique}, {channel}: {found} +- {error}, not {expected}");
            assert!(off(1.08 * found) > 1.0, "{technique}, {channel}: 8 % more would pass");
        }
    }
}

/// The camera sees unlit surfaces in mirrors, whatever the technique, without any light too. Rough surfaces are not lit
/// by them.
#[test]
fn mirrors_show_unlit_surfaces() {
    let metal = |roughness| Material { metallic: 1.0, roughness, ..surface(1.0, 0.0) };
    let plate = || {
        let (colour, at) = (Vec4::new(0.5, 0.25, 0.125, 1.0), DVec3::new(0.0, 0.0, 2.0));
        (square(at, DVec3::X, -DVec3::Y), Material { unlit: true, base_colour: colour, ..surface(1.0, 0.0) })
    };
    let view = camera(DVec3::new(0.0, 0.0, 1.0), DVec3::NEG_Z, 0.2);
    for (roughness, shown) in [(0.0, [0.5, 0.25, 0.125]), (0.5, [0.0; 3])] {
        let mirror = (square(DVec3::ZERO, DVec3::X, DVec3::Y), metal(roughness));
        let scene = scene(&[mirror, plate()], Vec::new());
        for technique in [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
            let (rendered, _) = render_scene(scene.clone(), &view, &settings(technique, 4));
            for (channel, shown) in ["R", "G", "B"].into_iter().zip(shown) {
                let (mean, _) = mean_and_error(&rendered, channel);
                // The reflectance of the mirror is 1 within the error of half floats, and the colour is linear.
                assert!((mean - shown).abs() < 1e-3, "{technique}, roughness {roughness}: {channel} is {mean}");
            }
        }
    }
}
