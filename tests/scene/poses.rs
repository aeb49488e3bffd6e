//! Poses of animated files against positions that another implementation computed, which Blender's importer confirmed:
//! `poses/make.py` writes them.

use std::path::{Path, PathBuf};

use glam::DVec3;
use penumbra::internal::scene::{ImportOptions, Scene};
use penumbra::{Error, Result};
use serde::Deserialize;

use crate::builder::world;
use crate::shared_files::shared_files;

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/scene/poses");

/// Maximum distance of a corner from where it should be, over the size of the scene. Positions of the scene are f32,
/// with a relative error of 6e-8; the rest is that of joint matrices and keys, which files have as f32.
const TOLERANCE: f64 = 1e-6;

/// A moment of an animation.
#[derive(Deserialize)]
struct Case {
    file: String,
    animation: usize,
    time: f64,
    /// Every how many triangles there is one in `kept`.
    step: usize,
    triangles: usize,
    kept: Vec<[[f64; 3]; 3]>,
}

fn cases() -> Vec<Case> {
    serde_json::from_slice(&std::fs::read(Path::new(FOLDER).join("expected.json")).unwrap()).unwrap()
}

fn load(path: &Path, case: &Case, time: f64) -> Result<Scene> {
    let animation = Some(case.animation.to_string());
    Scene::load(path, &ImportOptions { animation, time: Some(time), ..Default::default() })
}

/// The maximum distance of a corner from where it should be, over the size of the scene.
fn error(scene: &Scene, case: &Case) -> f64 {
    let triangles = world(scene);
    assert_eq!(triangles.len(), case.triangles, "{} at {}", case.file, case.time);
    let found = triangles.iter().step_by(case.step).flatten().map(|p| DVec3::from(*p));
    let expected = case.kept.iter().flatten().map(|p| DVec3::from(*p));
    // The bounding sphere has a radius between 1/2 and 1 in normalised space.
    found.zip(expected).map(|(found, expected)| found.distance(expected)).fold(0.0, f64::max)
        * scene.normalisation.scale()
}

fn check(cases: &[Case], path: impl Fn(&Case) -> PathBuf) {
    for case in cases {
        let path = path(case);
        let error_at = |time| error(&load(&path, case, time).unwrap_or_else(|e| panic!("{e}")), case);
        let error = error_at(case.time);
        assert!(error < TOLERANCE, "{} animation {} at {}: {error}", case.file, case.animation, case.time);
    }
}

#[test]
fn poses_are_those_of_another_implementation() {
    let (cases, _): (Vec<_>, Vec<_>) = cases().into_iter().partition(|case| case.file.ends_with(".gltf"));
    assert!(cases.len() > 10, "{}", cases.len());
    check(&cases, |case| Path::new(FOLDER).join(&case.file));
}

/// A moment that is a millisecond off is found, as is another animation, interpolation, or weight.
#[test]
fn planted_differences_are_found() {
    let cases = cases();
    let find = |name: &str, time: f64| cases.iter().find(|case| case.file == name && case.time == time).unwrap();
    let text = |name: &str| std::fs::read_to_string(Path::new(FOLDER).join(name)).unwrap();
    for (name, time, original, planted) in [
        ("arm.gltf", 0.7, "\"LINEAR\"", ""),
        ("arm.gltf", 0.7, "CUBICSPLINE", "LINEAR"),
        ("arm.gltf", 1.4, "STEP", "LINEAR"),
        ("arm.gltf", 1.4, "\"joints\": [\n    2,\n    3,", "\"joints\": [\n    3,\n    2,"),
        ("face.gltf", 0.9, "both", ""),
        ("face.gltf", 0.9, "CUBICSPLINE", "STEP"),
    ] {
        let (case, text) = (find(name, time), text(name));
        let mut options = ImportOptions { time: Some(time), ..Default::default() };
        let mut planted_text = text.replace(original, planted);
        if planted.is_empty() {
            // Time instead of text.
            options.time = Some(time + 1e-3);
            planted_text = text;
        }
        match Scene::from_bytes(planted_text.as_bytes(), Path::new(name), &options) {
            // A spline's three numbers for a key are not those of other interpolations.
            Err(error) => assert!(error.to_string().contains("elements"), "{error}"),
            Ok(scene) => assert!(error(&scene, case) > TOLERANCE, "{name}: {original} for {planted} is not found"),
        }
    }
}

#[test]
fn the_fox_runs_as_elsewhere() {
    let Some(files) = shared_files("models", &["glb"]) else { return };
    let fox = files.into_iter().find(|file| file.ends_with("Fox.glb")).unwrap();
    let (cases, _): (Vec<_>, Vec<_>) = cases().into_iter().partition(|case| case.file == "Fox.glb");
    assert!(cases.len() > 5, "{}", cases.len());
    check(&cases, |_| fox.clone());
    let late = load(&fox, &cases[0], cases[0].time + 1e-3).unwrap();
    assert!(error(&late, &cases[0]) > TOLERANCE, "a millisecond is not seen");
}

/// The outcome depends on the byte. Only panics and hangs are failures.
#[test]
fn no_wrong_byte_of_an_animated_file_causes_a_panic() {
    for name in ["arm.gltf", "face.gltf"] {
        let bytes = std::fs::read(Path::new(FOLDER).join(name)).unwrap();
        for i in 0..bytes.len() {
            // A digit more or less, another letter, another sign.
            let mut damaged = bytes.clone();
            damaged[i] ^= [0x01, 0x02, 0x08][i % 3];
            let options = ImportOptions { time: Some(0.9), ..Default::default() };
            let outcome = Scene::from_bytes(&damaged, Path::new(name), &options);
            // A file that has lost its animation has no time.
            assert!(matches!(outcome, Ok(_) | Err(Error::Input { .. } | Error::Setting { name: "time", .. })));
        }
    }
}
