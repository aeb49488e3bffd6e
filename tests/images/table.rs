//! The results of an independent simulation of the counting rules (double precision, kd-tree): reduction, fill and miss
//! in the two scenes of the paper, at 200 x 200 pixels with one sample each.

use penumbra::{Aov, Settings, Technique};

use crate::setup::{render, scene_file};

struct Row {
    scene: &'static str,
    photons: u32,
    nearest: u32,
    paper_counting: bool,
    dilate: u32,
    /// 1 - boundary share.
    reduction: f64,
    fill: f64,
    miss: f64,
}

const ROWS: [Row; 5] = [
    Row {
        scene: "sphere.glb",
        photons: 100_000,
        nearest: 30,
        paper_counting: true,
        dilate: 0,
        reduction: 0.917,
        fill: 0.16,
        miss: 0.0,
    },
    Row {
        scene: "sphere.glb",
        photons: 100_000,
        nearest: 30,
        paper_counting: false,
        dilate: 0,
        reduction: 0.944,
        fill: 0.23,
        miss: 0.0,
    },
    Row {
        scene: "sphere.glb",
        photons: 400_000,
        nearest: 30,
        paper_counting: false,
        dilate: 0,
        reduction: 0.970,
        fill: 0.43,
        miss: 0.0,
    },
    Row {
        scene: "box.glb",
        photons: 131_072,
        nearest: 50,
        paper_counting: false,
        dilate: 0,
        reduction: 0.910,
        fill: 0.98,
        miss: 0.006,
    },
    Row {
        scene: "box.glb",
        photons: 131_072,
        nearest: 50,
        paper_counting: false,
        dilate: 1,
        reduction: 0.900,
        fill: 0.92,
        miss: 0.0014,
    },
];

/// Reduction, fill and miss match the simulation within 1.5 percentage points.
#[test]
fn shares_match_the_simulation() {
    for scene in ["sphere.glb", "box.glb"] {
        let rows = ROWS.iter().filter(|row| row.scene == scene);
        let base = Settings::default().with(|s| {
            s.image.width = 200;
            s.image.height = 200;
            s.image.spp = 1;
            s.visibility_map.audit = 0.0;
            s.indirect.max_bounces = 0;
            s.image.aovs = vec![Aov::Shadow];
        });
        // True visibility at the same pixel centres, from 256 points on the light.
        let all = base.clone().with(|s| {
            s.technique = Technique::TWO_PASS;
            s.shadow_rays.samples = 256;
        });
        let (truth, _) = render(&scene_file(scene), &all);
        let of = |name: &str| format!("shadow.light.{name}");
        let visibility = truth.channel(&of("visibility")).unwrap();
        for row in rows {
            let settings = base.clone().with(|s| {
                s.visibility_map.photons_per_light = Some(row.photons);
                s.visibility_map.nearest = row.nearest;
                s.visibility_map.paper_counting = row.paper_counting;
                s.visibility_map.dilate = Some(row.dilate);
            });
            let (image, statistics) = render(&scene_file(scene), &settings);
            let class = image.channel(&of("class")).unwrap();
            let (mut boundary, mut penumbra_boundary, mut missed) = (0u32, 0u32, 0u32);
            for (class, v) in class.iter().zip(visibility) {
                let penumbra = *v > 0.0 && *v < 1.0;
                match *class as u32 {
                    1 => missed += u32::from(*v < 1.0),
                    2 => missed += u32::from(*v > 0.0),
                    3 | 4 => {
                        boundary += 1;
                        penumbra_boundary += u32::from(penumbra);
                    }
                    _ => {}
                }
            }
            let points = statistics.points.total as f64;
            let reduction = 1.0 - statistics.points.boundary_share;
            let fill = f64::from(penumbra_boundary) / f64::from(boundary);
            let miss = f64::from(missed) / points;
            println!(
                "{scene} {} photons, k {}, paper counting {}, dilate {}: \
                 reduction {reduction:.4}, fill {fill:.3}, miss {miss:.4}",
                row.photons, row.nearest, row.paper_counting, row.dilate
            );
            assert!(f64::from(boundary) / points > 0.01, "hardly any boundary: the test is not sensitive");
            // The project's limit is 1.5 percentage points.
            assert!(
                (reduction - row.reduction).abs() < 0.015,
                "{scene}: reduction {reduction}, expected {}",
                row.reduction
            );
            // The sphere's image has only some hundred boundary points: the limit plus two standard errors.
            let error = (row.fill * (1.0 - row.fill) / f64::from(boundary)).sqrt();
            assert!(
                (fill - row.fill).abs() < 0.015 + 2.0 * error,
                "{scene}: fill {fill}, expected {} within {error}",
                row.fill
            );
            assert!((miss - row.miss).abs() < 0.015, "{scene}: miss {miss}, expected {}", row.miss);
        }
    }
}
