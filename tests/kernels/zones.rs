//! Pass `zones` against a count on the CPU.

use glam::Vec3;
use kernel_kit::{Gpu, kernel_test};
use penumbra::internal::kernels::{GridShape, MAX_LIGHTS, ZONE_LIGHTS};
use penumbra::internal::passes::grid::{Grid, Photon};
use penumbra::internal::passes::zones::Zones;
use penumbra::internal::specialisation::kernels::sorting_grid;

use crate::kit::device_features;
use crate::rooms::{Random, photon};

/// Planted faults that the comparison must detect.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// Neighbouring zones do not count.
    Alone,
    /// Lights with only shadow photons are listed.
    Shadowed,
    /// The listed lights are those with the most photons, regardless of power.
    Powerless,
}

/// The list of one zone: (light, share in 65,535ths; the list holds its square root).
fn expected(
    photons: &[Photon],
    shape: &GridShape,
    zone: u32,
    powers: &[f32],
    environment: bool,
    fault: Fault,
) -> Vec<u32> {
    let axis = |photon: &Photon, axis: usize| {
        let at = ((photon.position[axis] - shape.origin[axis]) * shape.inverse_cell).floor();
        (at as i64).clamp(0, i64::from(shape.size[axis]) - 1)
    };
    let [x, y, _] = shape.size;
    let at = [zone % x, zone / x % y, zone / (x * y)].map(i64::from);
    let reach = i64::from(fault != Fault::Alone);
    let mut tallies = vec![[0u32; 2]; powers.len()];
    for photon in photons.iter().filter(|p| (0..3).all(|a| (axis(p, a) - at[a]).abs() <= reach)) {
        tallies[photon.light() as usize][(photon.word >> 31) as usize] += 1;
    }
    let strength = |light: usize| {
        let power = if fault == Fault::Powerless { 1.0 } else { powers[light] };
        // To the upper two bits of a float's mantissa.
        (tallies[light][0].max(u32::from(fault == Fault::Shadowed)) as f32 * power).to_bits() >> 21
    };
    let reaches = |light: &usize| match fault {
        Fault::Shadowed => tallies[*light] != [0, 0],
        _ => tallies[*light][0] > 0,
    };
    let mut lights: Vec<usize> = (0..powers.len()).filter(reaches).collect();
    // A stable sort: of equal lights the first.
    lights.sort_by_key(|light| std::cmp::Reverse(strength(*light)));
    lights.truncate(ZONE_LIGHTS as usize - usize::from(environment));
    lights.sort();
    let word = |light: usize| {
        let [lit, shadow] = tallies[light].map(f64::from);
        light as u32 | ((65535.0 * (lit / (lit + shadow)).sqrt()).round() as u32) << 16
    };
    let mut words: Vec<u32> = lights.into_iter().map(word).collect();
    words.extend(environment.then_some(powers.len() as u32 | 0xffff_0000));
    words.resize(ZONE_LIGHTS as usize, 0);
    words
}

/// The same light, and a share that differs by rounding only.
fn alike(a: u32, b: u32) -> bool {
    a & 0xffff == b & 0xffff && (a >> 16).abs_diff(b >> 16) <= 1
}

/// Photons in a cube around the origin, most of them of the first lights, and in clusters, so that there are lists of
/// every length.
fn scattered(count: usize, lights: u32, random: &mut Random) -> Vec<Photon> {
    let one = |random: &mut Random| {
        let light = (random.unit().powi(2) * lights as f32) as u32;
        let cluster = Vec3::new((light % 5) as f32 - 2.0, (light % 3) as f32 - 1.0, (light % 7) as f32 - 3.0) / 8.0;
        let position = cluster + 0.12 * Vec3::new(random.signed(), random.signed(), random.signed());
        photon(position, random.direction(), light.min(lights - 1), random.unit() < 0.4)
    };
    (0..count).map(|_| one(random)).collect()
}

/// Each zone lists the lights with photons in it and its neighbours, the strongest if there are too many, with their
/// shares of illumination photons. The cases: no photons and one, numbers of lights around the length of a list and the
/// maximum, and more than 65,535 zones.
#[kernel_test("PENUMBRA_DEVICE")]
fn zones_list_the_lights_that_reach_them(gpu: &Gpu) {
    let mut random = Random(5);
    let features = sorting_grid(&device_features(gpu));
    let (sorting, zones) = (Grid::sorting_only(gpu, &features).unwrap(), Zones::new(gpu, &features).unwrap());
    let cases = [
        (0usize, 1u32, 1e2, false),
        (1, 1, 1e2, true),
        (3000, 63, 60.0, true),
        (3000, 64, 60.0, true),
        (3000, 64, 60.0, false),
        (3000, 65, 1.0, false),
        (20_000, 300, 100.0, true),
        (40_000, MAX_LIGHTS, 100.0, false),
        (200, 3, 7e4, false),
    ];
    let mut caught = [0; 3];
    for (count, lights, max_cells, environment) in cases {
        let photons = scattered(count, lights, &mut random);
        let bounds = (Vec3::splat(-0.5), Vec3::splat(0.5));
        let shape = GridShape::with_max_cells(1.0, bounds, 1e-6, 1, max_cells);
        let powers: Vec<f64> = (0..lights).map(|_| f64::from(random.unit()).powi(8)).collect();
        let buffer = gpu.upload("test/photons", &photons).unwrap();
        let sorted = sorting.sort(gpu, &buffer, count as u32, 1, shape).unwrap();
        let table = zones.list(gpu, &sorted, &powers, environment).unwrap();
        let words = (shape.cells() * ZONE_LIGHTS) as usize;
        let got: Vec<u32> = gpu.read(&table.lists, words).unwrap();
        let strongest = powers.iter().copied().fold(0.0, f64::max);
        let powers: Vec<f32> = powers.iter().map(|power| (power / strongest) as f32).collect();
        // All zones, or a thousand of them, the last included.
        let step = (shape.cells() as usize / 1000).max(1);
        let mut lengths = [usize::MAX, 0];
        for zone in (0..shape.cells()).rev().step_by(step) {
            let list = &got[(zone * ZONE_LIGHTS) as usize..][..ZONE_LIGHTS as usize];
            let of = |fault| expected(&photons, &shape, zone, &powers, environment, fault);
            let right = of(Fault::None);
            let same = |words: &[u32]| list.iter().zip(words).all(|(a, b)| alike(*a, *b));
            assert!(same(&right), "{count} photons of {lights} lights, zone {zone}: {list:x?}, expected {right:x?}");
            for (caught, fault) in caught.iter_mut().zip([Fault::Alone, Fault::Shadowed, Fault::Powerless]) {
                *caught += usize::from(!same(&of(fault)));
            }
            let length = right.iter().filter(|word| **word != 0).count();
            lengths = [lengths[0].min(length), lengths[1].max(length)];
        }
        println!("{count} photons of {lights} lights: {} zones of {lengths:?} lights", shape.cells());
        assert!(max_cells < 7e4 || shape.cells() > 65_535, "{} zones", shape.cells());
    }
    println!("faults in {caught:?} zones");
    assert!(caught.iter().all(|zones| *zones > 20), "faults that nothing shows: {caught:?}");
}
