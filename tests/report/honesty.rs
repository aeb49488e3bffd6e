//! Stated confidence intervals contain the true value as often as they claim.

use penumbra::{Aov, Renderer, Settings};

use crate::device::gpu;
use crate::setup::Box;

/// The audits' 95 % interval of the miss bias contains the true value for 90 to 99 of 100 seeds. The truth comes from
/// auditing every point. Intervals of half the width contain it too rarely, which shows that the test is sensitive.
#[test]
fn audits_state_honest_intervals() {
    const RENDERS: u32 = 100;
    let Box { scene, camera } = Box::load();
    // With one sample no audit repairs the map, so both renders have the same one. Few photons make some classes wrong,
    // and more where every point counts its own, for the AOV, than where cells decide for all of their points.
    let base = Settings::default().with(|s| {
        s.image.width = 96;
        s.image.height = 96;
        s.image.spp = 1;
        s.indirect.max_bounces = 0;
        s.visibility_map.photons_per_light = Some(4096);
        s.visibility_map.nearest = 3;
        s.image.aovs = vec![Aov::Shadow];
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
    println!("{held} of {RENDERS} intervals contain the truth, {held_by_half} at half the width; {wrong} wrong audits");
    assert!(wrong > u64::from(RENDERS), "too few wrong classes for a conclusion: {wrong}");
    // Of 100 intervals of 95 %, 95 hold on average, with a standard deviation of 2.2: 90 is 2.3 of these below.
    // Intervals that all hold would be too wide.
    assert!((90..=99).contains(&held), "{held} of {RENDERS}");
    assert!(held_by_half < 90, "half the interval would be enough");
}
