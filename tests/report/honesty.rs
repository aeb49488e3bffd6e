//! Stated intervals hold the truth as often as they say.

use penumbra::{Renderer, Settings};

use crate::device::gpu;
use crate::setup::Box;

/// What audits of a few points say of wrong classes, against an audit of every point, over the maps of 100 seeds: of intervals of
/// 95 %, 90 to 99 hold the truth. Halved, too few of them do.
#[test]
fn audits_state_honest_intervals() {
    const RENDERS: u32 = 100;
    let Box { scene, camera } = Box::load();
    // One sample, so that no audit mends the map that the other render has; few photons, so that classes are wrong.
    let base = Settings::default().with(|s| {
        s.image.width = 96;
        s.image.height = 96;
        s.image.spp = 1;
        s.indirect.max_bounces = 0;
        s.visibility_map.photons_per_light = 4096;
        s.visibility_map.nearest = 3;
    });
    let audits = |seed: u32, audit: f32| {
        let settings = base.clone().with(|s| {
            s.image.seed = seed;
            s.visibility_map.audit = audit;
        });
        let mut renderer = Renderer::new(gpu(), scene.clone(), &camera, &settings).unwrap();
        renderer.render_batch().unwrap();
        renderer.statistics().unwrap().audits
    };
    let (mut held, mut held_by_half, mut wrong) = (0, 0, 0);
    for seed in 0..RENDERS {
        let truth = audits(seed, 1.0).miss_bias;
        let stated = audits(seed, 1.0 / 64.0);
        let [low, high] = stated.miss_bias_interval;
        held += u32::from((low..=high).contains(&truth));
        let middle = stated.miss_bias;
        held_by_half += u32::from(((low + middle) / 2.0..=(high + middle) / 2.0).contains(&truth));
        wrong += stated.wrong;
    }
    println!("{held} of {RENDERS} intervals hold the truth, {held_by_half} of half of them; {wrong} wrong audits");
    assert!(wrong > u64::from(RENDERS), "too few wrong classes to tell anything: {wrong}");
    assert!((90..=99).contains(&held), "{held} of {RENDERS}");
    assert!(held_by_half < 90, "half of the interval would do");
}
