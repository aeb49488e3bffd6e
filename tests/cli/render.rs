//! `penumbra render`: outputs, statistics, messages, and signals.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use penumbra::Image;
use penumbra::internal::render::film::{Metadata, View};
use serde_json::Value;

use crate::program::{Answer, BOX, STILL_LIFE, device, folder, penumbra, run};
use crate::schema;

/// Quick settings: few photons, a small image.
const SMALL: &str = "--width 24 --height 16 --photons 4096";

/// Renders the box to `outputs` with `arguments`.
fn render(arguments: &str, outputs: &[&Path]) -> Answer {
    render_scene(BOX, arguments, outputs)
}

fn render_scene(scene: &str, arguments: &str, outputs: &[&Path]) -> Answer {
    let mut command = penumbra(&format!("render --device {} {SMALL} {arguments}", device()), &[&scene]);
    for output in outputs {
        command.arg("-o").arg(output);
    }
    Answer::of(&mut command)
}

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn channels(image: &Image) -> BTreeSet<&str> {
    image.channels.iter().map(|channel| channel.name.as_str()).collect()
}

/// A summary, and notes on pictures that show little.
#[test]
fn a_render_says_what_it_made() {
    let folder = folder();
    let png = folder.path().join("a.png");
    let said = |arguments: &str| render(&format!("--spp 2 {arguments}"), &[&png]).assert_done().stderr.clone();
    let usual = said("--nearest 50");
    assert!(usual.contains(" % of shadow rays saved") && !usual.contains("mostly"), "{usual}");
    assert!(!said("--technique two-pass").contains("shadow rays saved"));
    for (exposure, seen, back) in [(12.0, "white", -4.0..2.0), (-16.0, "black", -4.0..2.0)] {
        let said = said(&format!("--exposure {exposure}"));
        let (_, suggested) = said.split_once(&format!("a.png is mostly {seen}: try --exposure ")).expect(&said);
        let suggested: f64 = suggested.lines().next().unwrap().parse().unwrap();
        assert!(back.contains(&suggested), "{said}");
    }
}

#[test]
fn one_render_goes_to_several_files_by_their_extensions() {
    let folder = folder();
    let [exr, png, again] = ["a.exr", "b.PNG", "c.png"].map(|name| folder.path().join(name));
    fs::write(&png, "old").unwrap();
    render("--spp 2 --seed 4294967295 --view agx --exposure -1 --denoise none", &[&exr, &png, &again]).assert_done();
    let image = Image::read(&exr).unwrap();
    assert_eq!((image.width, image.height), (24, 16));
    assert_eq!(channels(&image), ["A", "B", "G", "R"].into());
    assert!(image.channels.iter().all(|channel| channel.samples.iter().all(|x| x.is_finite())));
    assert_eq!(image.metadata["samplesPerPixel"], Metadata::Int(2));
    assert_eq!(image.metadata["penumbra:seed"], Metadata::Text("4294967295".into()));

    // The PNG is that view of the EXR.
    let expected = folder.path().join("expected.png");
    image.write_png(&expected, View::Agx, -1.0).unwrap();
    for file in [&png, &again] {
        assert!(fs::read(file).unwrap() == fs::read(&expected).unwrap(), "{}", file.display());
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 4, "something was left behind");
}

/// Composed kernels are kept in the user's cache folder, and the next render uses what it finds there. An empty file in
/// place of a kernel and a folder that cannot be created change nothing.
#[cfg(target_os = "linux")]
#[test]
fn kernels_are_kept_for_the_next_render() {
    let folder = folder();
    let (cache, image) = (folder.path().join("cache"), folder.path().join("a.exr"));
    fs::create_dir(&cache).unwrap();
    let render = || {
        let arguments = format!("render --device {} --width 8 --height 8 --spp 1 --technique path", device());
        let outcome = Answer::of(penumbra(&arguments, &[&BOX]).arg("-o").arg(&image).env("XDG_CACHE_HOME", &cache));
        outcome.assert_done();
        (outcome.stderr, fs::read(&image).unwrap())
    };
    let (_, first) = render();
    let kernels = cache.join("penumbra").join("kernels");
    let files: Vec<_> = fs::read_dir(&kernels).unwrap().map(|file| file.unwrap().path()).collect();
    assert!(files.len() >= 3, "{files:?}");
    let texts = || files.iter().map(|file| fs::read_to_string(file).unwrap()).collect::<Vec<_>>();
    let written = texts();
    files.iter().for_each(|file| fs::write(file, "").unwrap());
    assert!(render().1 == first);
    assert_eq!(texts(), written);
    fs::remove_dir_all(cache.join("penumbra")).unwrap();
    fs::write(cache.join("penumbra"), "a file in the place of the folder").unwrap();
    let (said, third) = render();
    assert!(third == first && !said.contains("cache"), "{said}");
}

/// The ratio of the first sample's time to the expected time is stored, but not if the driver had to compile kernels.
/// After first samples that took far longer than expected, a short render uses `path`. A damaged file counts as no
/// file.
#[cfg(target_os = "linux")]
#[test]
fn times_of_first_samples_are_remembered() {
    if device() != "software" {
        return;
    }
    let folder = folder();
    let (cache, image) = (folder.path().join("cache"), folder.path().join("a.exr"));
    let file = cache.join("penumbra").join("first_samples.json");
    let render = |arguments: &str| {
        let arguments = format!("render --device software --width 16 --height 16 {arguments}");
        let mut render = penumbra(&arguments, &[&BOX]);
        // The driver has compiled nothing for this folder.
        render.arg("-o").arg(&image).env("XDG_CACHE_HOME", &cache).env_remove("MESA_SHADER_CACHE_DIR");
        let outcome = Answer::of(&mut render);
        outcome.assert_done();
        outcome.stderr
    };
    render("--spp 1");
    assert!(!file.exists(), "kernels were compiled");
    render("--spp 1 --technique path");
    render("--spp 1 --photons 4096");
    assert!(!file.exists(), "nothing is expected of these");
    // Loading a kernel may take as long as compiling it while the machine is busy, and then nothing is remembered.
    let remembers = || {
        let before = fs::read(&file).ok();
        (0..10).any(|_| {
            render("--spp 1");
            fs::read(&file).ok() != before
        })
    };
    assert!(remembers());
    let remembered = read_json(&file);
    let (device, ratios) = remembered.as_object().unwrap().iter().next().unwrap();
    assert!(ratios.as_array().unwrap().len() == 1 && ratios[0].as_f64().unwrap() > 0.0, "{ratios}");

    let takes_paths = || {
        let said = render("--spp 4 --time 10");
        let is_reason = said.contains("using --technique path, because photons and records would take about");
        assert_eq!(said.contains("pixels, path, on"), is_reason, "{said}");
        is_reason
    };
    assert!(!takes_paths());
    // The lower quartile is the third of nine.
    let quiet = |renders: usize| (0..9).map(|k| if k < renders { 1.0 } else { 1e3 }).collect();
    for (ratios_now, expected) in [(vec![1e3; 2], false), (vec![1e3; 3], true), (quiet(2), true), (quiet(3), false)] {
        fs::write(&file, serde_json::json!({ device: ratios_now }).to_string()).unwrap();
        assert_eq!(takes_paths(), expected, "{ratios_now:?}");
    }
    fs::write(&file, "no JSON").unwrap();
    assert!(!takes_paths());
    fs::write(&file, serde_json::json!({ device: vec![2.0; 20] }).to_string()).unwrap();
    assert!(remembers());
    let kept = read_json(&file);
    assert_eq!(kept.as_object().unwrap().values().next().unwrap().as_array().unwrap().len(), 9, "{kept}");
}

#[test]
fn the_requested_channels_are_written() {
    let folder = folder();
    let file = folder.path().join("a.exr");
    let layers = |arguments: &str| {
        render(&format!("--spp 1 {arguments}"), &[&file]).assert_done();
        let image = Image::read(&file).unwrap();
        let layer = |name: &str| name.split('.').next().unwrap().to_owned();
        image.channels.iter().map(|channel| layer(&channel.name)).collect::<BTreeSet<_>>()
    };
    let set = |names: &[&str]| names.iter().map(|name| name.to_string()).collect::<BTreeSet<_>>();
    assert_eq!(layers("--aov Z,N,Z"), set(&["R", "G", "B", "A", "N", "Z"]));
    let all = ["R", "G", "B", "A", "N", "P", "Z", "albedo", "direct", "indirect", "samples", "shadow", "variance"];
    assert_eq!(layers("--aov all"), set(&all));
}

#[test]
fn statistics_are_as_documented_and_add_up() {
    let folder = folder();
    let [image, file] = ["a.exr", "a.json"].map(|name| folder.path().join(name));
    render(&format!("--spp 3 --seed 7 --aov N --stats {}", file.display()), &[&image]).assert_done();
    let statistics = read_json(&file);
    schema::assert_documented("Statistics", &statistics);

    let count = |pointer: &str| statistics.pointer(pointer).unwrap().as_u64().unwrap();
    let sum = |holder: &str, keys: &[&str]| keys.iter().map(|key| count(&format!("{holder}/{key}"))).sum::<u64>();
    assert_eq!(count("/rays/total"), sum("/rays", &["camera", "photon", "shadow", "audit", "bounce", "gather"]));
    assert_eq!(count("/points/total"), sum("/points", &["lit", "shadowed", "boundary", "unknown"]));
    assert_eq!(count("/samples"), 3);
    assert_eq!(count("/rays/camera"), 24 * 16 * 3);
    // One light: at most one point per sample.
    assert!(count("/points/total") > 0 && sum("/points", &["total", "dark"]) <= count("/rays/camera"));
    let boundary = sum("/points", &["boundary", "unknown"]) as f64 / count("/points/total") as f64;
    // Both are the same quotient of integers in f64.
    assert_eq!(statistics["points"]["boundary_share"].as_f64().unwrap(), boundary);
    // Each boundary or unknown point samples at most 4 light points: those in front of it.
    assert!(count("/rays/shadow") <= 4 * sum("/points", &["boundary", "unknown"]));
    assert_eq!(count("/photons/0/emitted"), 4096);
    assert!(count("/photons/0/illumination") > 0 && count("/photons/0/illumination") <= 4096);
    assert!(count("/audits/wrong") <= count("/audits/audited"));
    assert_eq!(count("/not_finite"), 0);
    assert_eq!((count("/scene/triangles"), count("/scene/lights")), (24, 1));

    let settings = &statistics["settings"];
    assert_eq!((&settings["seed"], &settings["spp"], &settings["photons"]), (&7.into(), &3.into(), &4096.into()));
    assert_eq!(statistics["version"], env!("CARGO_PKG_VERSION"));
    let time = |key: &str| statistics["time"][key].as_f64().unwrap();
    for part in ["start", "import", "bvh", "compile", "render"] {
        assert!(time(part) > 0.0 && time(part) <= time("total"), "{part}: {}", statistics["time"]);
    }

    let plan = run(&format!("plan --json {SMALL} --aov N"), &[&BOX]).json();
    for list in ["kept", "left_out"] {
        let names: Vec<&Value> = plan[list].as_array().unwrap().iter().map(|item| &item["name"]).collect();
        assert_eq!(statistics[list].as_array().unwrap().iter().collect::<Vec<_>>(), names);
    }
}

#[test]
fn progress_is_a_few_lines_and_quiet_is_silent() {
    let folder = folder();
    let file = folder.path().join("a.png");
    let talking = render("--spp 64", &[&file]);
    talking.assert_done();
    assert!(talking.stdout.is_empty());
    assert!(talking.stderr.contains("64 spp") && talking.stderr.contains(&format!("wrote {}", file.display())));
    assert!(!talking.stderr.contains('\u{1b}'), "no terminal, no colours: {talking:?}");
    assert!(talking.stderr.lines().count() < 20, "{talking:?}");

    fs::remove_file(&file).unwrap();
    let quiet = render("--spp 64 --quiet", &[&file]);
    quiet.assert_done();
    assert_eq!((quiet.stdout.as_str(), quiet.stderr.as_str()), ("", ""));
    assert!(file.exists());
}

#[test]
fn notes_are_said_once_and_kept_in_the_statistics() {
    let folder = folder();
    let [scene, image, file] = ["nothing.gltf", "a.png", "a.json"].map(|name| folder.path().join(name));
    fs::write(&scene, r#"{"asset": {"version": "2.0"}}"#).unwrap();
    let answer =
        run(&format!("render --device {} {SMALL} --spp 1", device()), &[&scene, &"-o", &image, &"--stats", &file]);
    answer.assert_done();
    let said: Vec<&str> = answer.stderr.lines().filter_map(|line| line.strip_prefix("note: ")).collect();
    assert!(
        said.contains(&"no camera in the scene") && said.contains(&"no light in the file: --default-light adds one"),
        "{answer:?}"
    );
    assert_eq!(said.iter().collect::<BTreeSet<_>>().len(), said.len(), "{said:?}");
    let kept = read_json(&file);
    let kept: Vec<&str> = kept["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap()).collect();
    assert_eq!(kept, said);
}

/// A time budget ends a render without a number of samples; a number of samples ends one within its budget.
#[test]
fn a_render_ends_by_time_or_by_samples() {
    let folder = folder();
    let [image, file] = ["a.exr", "a.json"].map(|name| folder.path().join(name));
    let samples = |arguments: &str| {
        render(&format!("{arguments} --stats {}", file.display()), &[&image]).assert_done();
        read_json(&file)["samples"].as_u64().unwrap()
    };
    assert!(samples("--time 0.001") >= 1);
    assert_eq!(samples("--time 3600 --spp 2"), 2);
}

/// Renders that are stopped after each batch, against an uninterrupted render. The tests in `extremes` resume all
/// techniques, within one process.
#[test]
fn a_resumed_render_has_the_bits_of_one_that_never_stopped() {
    let folder = folder();
    let [whole, parts, state, stats] = ["a.exr", "b.exr", "state", "a.json"].map(|name| folder.path().join(name));
    let cases = [
        (BOX, "--aov all"),
        // Without the AOV of classes there are fine cells, and most points of the still life are shaded at once. It has
        // enough lights for ward-adaptive to estimate some by their visibility so far.
        (BOX, "--aov variance --nearest 511"),
        (STILL_LIFE, "--aov variance"),
        (STILL_LIFE, "--aov variance --light-sampling zones --sampled-lights 2"),
        (STILL_LIFE, "--aov all --technique ward-adaptive --shadow-tolerance 0.5"),
    ];
    for (scene, arguments) in cases {
        let _ = fs::remove_file(&state);
        let arguments = format!("{arguments} --spp 20 --seed 3 --audit 0.25");
        let render = |arguments: &str, output: &Path| render_scene(scene, arguments, &[output]);
        render(&arguments, &whole).assert_done();
        let stopped = format!("{arguments} --time 0.001 --checkpoint {} --stats {}", state.display(), stats.display());
        render(&stopped, &parts).assert_done();
        let mut stops = 0;
        while read_json(&stats)["samples"] != 20 {
            stops += 1;
            render(&format!("{stopped} --resume"), &parts).assert_done();
        }
        assert!(stops >= 2, "{arguments}: never stopped");
        let [whole, parts] = [&whole, &parts].map(|path| Image::read(path).unwrap());
        for channel in &whole.channels {
            let bits = |samples: &[f32]| samples.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            let same = bits(&channel.samples) == bits(parts.channel(&channel.name).unwrap());
            assert!(same, "{arguments}: {} differs", channel.name);
        }
    }
}

#[test]
fn checkpoints_of_something_else_are_refused() {
    let folder = folder();
    let [image, state] = ["a.png", "state"].map(|name| folder.path().join(name));
    let checkpoint = format!("--checkpoint {}", state.display());
    render(&format!("--spp 2 {checkpoint}"), &[&image]).assert_done();
    let good = fs::read(&state).unwrap();
    // Nor is one overwritten by another render.
    let other = render(&format!("--spp 2 {checkpoint}"), &[&image]);
    other.assert_refused(2, &["--checkpoint", "state exists already", "--resume"]);
    assert!(fs::read(&state).unwrap() == good);
    let resume = |arguments: &str| {
        let arguments = format!("render --device {} {SMALL} --quiet {checkpoint} --resume {arguments} -o", device());
        run(&arguments, &[&image, &BOX])
    };
    resume("--spp 2").assert_done();
    for (other, difference) in [
        ("--spp 2 --seed 1", "other settings: seed is 0, not 1"),
        ("--spp 4", "spp is 2, not 4"),
        ("--spp 2 --max-bounces 0", "max_bounces is 64, not 0"),
        ("--spp 2 --light-scale 2", "light_scale is 1.0, not 2.0"),
    ] {
        resume(other).assert_refused(3, &["state", difference]);
    }
    let arguments = format!("render --device {} {SMALL} --spp 2 --quiet {checkpoint} --resume -o", device());
    run(&arguments, &[&image, &STILL_LIFE]).assert_refused(3, &["state", "another scene"]);

    let at = |bytes: &[u8], word: &str| {
        bytes.windows(word.len()).position(|part| part == word.as_bytes()).unwrap() + word.len()
    };
    let mut other = good.clone();
    other[at(&good, "\"version\":\"")] ^= 1;
    let mut flipped = good.clone();
    *flipped.last_mut().unwrap() ^= 1;
    // The numbers of the header are part of the digest: otherwise the image would be 4.5 times too dark.
    let mut samples = good.clone();
    samples[at(&good, "\"samples\":")] = b'9';
    // A forged file with a valid digest has a stage of indirect light that does not exist.
    // The first line tells the version. The digest of all that follows comes next, then the header's length.
    let digest_at = at(&good, "\n");
    let rest_at = digest_at + 32;
    let whole = |mut bytes: Vec<u8>| {
        let digest = penumbra::internal::fingerprint::digest(&bytes[rest_at..]);
        bytes[digest_at..rest_at].copy_from_slice(digest.as_bytes());
        bytes
    };
    let stages = at(&good, "\"later_stages\":[");
    let stage = if good[stages] == b']' { "99" } else { "99," };
    let mut forged = good.clone();
    forged.splice(stages..stages, stage.bytes());
    let length = &mut forged[rest_at..rest_at + 8];
    let longer = u64::from_le_bytes(length.try_into().unwrap()) + stage.len() as u64;
    length.copy_from_slice(&longer.to_le_bytes());
    let cases = [
        (samples.clone(), "damaged"),
        (whole(forged), "damaged"),
        (other, "version"),
        (flipped, "damaged"),
        (good[..good.len() - 4].to_vec(), "damaged"),
        (good[..30].to_vec(), "damaged"),
        (b"something else".to_vec(), "not a checkpoint"),
        (Vec::new(), "not a checkpoint"),
    ];
    for (bytes, word) in cases {
        fs::write(&state, bytes).unwrap();
        resume("--spp 2").assert_refused(3, &["state", word]);
    }
    // Where there is none, the render begins.
    fs::remove_file(&state).unwrap();
    resume("--spp 2").assert_done();
    fs::remove_file(&state).unwrap();
    // Photons that audits added (a class by one photon is sometimes wrong), with positions that are not finite and a
    // light that does not exist, which would be counted past the last.
    let audited = |arguments: &str| {
        let sampling = "--spp 9 --audit 1 --nearest 1 --dilate 0 --width 96 --height 96 --photons 5184";
        let arguments = format!("render --device {} --quiet {sampling} {checkpoint} {arguments} -o", device());
        run(&arguments, &[&image, &BOX])
    };
    audited("").assert_done();
    let mut invalid = fs::read(&state).unwrap();
    let counts = ["\"added\":", "\"left\":"].map(|word| invalid[at(&invalid, word)]);
    assert!(counts.iter().any(|digit| *digit > b'0'), "audits left nothing");
    let header_at = rest_at + 8;
    let header = header_at + u64::from_le_bytes(invalid[rest_at..header_at].try_into().unwrap()) as usize;
    invalid[header..].fill(0xff);
    fs::write(&state, whole(invalid)).unwrap();
    audited("--resume").assert_refused(3, &["state", "damaged"]);
}

/// With adaptive sampling, a checkpoint holds which pixels are next: a resumed render samples the same pixels.
#[test]
fn a_resumed_render_samples_the_same_pixels() {
    let folder = folder();
    let [whole, parts, state, stats] = ["a.exr", "b.exr", "state", "a.json"].map(|name| folder.path().join(name));
    for flags in [
        "--technique path --noise 0.03",
        "--technique shadow-photons --noise 0.03",
        "--technique shadow-photons --sampling adaptive --spp 14",
    ] {
        let _ = fs::remove_file(&state);
        let arguments = format!("{flags} --aov samples --stats {}", stats.display());
        render(&arguments, &[&whole]).assert_done();
        let samples = read_json(&stats)["mean_samples"].clone();
        let stopped = format!("{arguments} --time 0.001 --checkpoint {}", state.display());
        render(&stopped, &[&parts]).assert_done();
        let mut stops = 0;
        while read_json(&stats)["mean_samples"] != samples {
            stops += 1;
            assert!(stops < 100, "{flags}: other samples");
            render(&format!("{stopped} --resume"), &[&parts]).assert_done();
        }
        assert!(stops >= 2, "{flags}: never stopped");
        let [whole, parts] = [&whole, &parts].map(|path| Image::read(path).unwrap());
        for channel in &whole.channels {
            let bits = |samples: &[f32]| samples.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            let same = bits(&channel.samples) == bits(parts.channel(&channel.name).unwrap());
            assert!(same, "{flags}: {} differs", channel.name);
        }
    }
}

#[test]
fn noise_ends_a_render_and_a_reference_is_compared_with() {
    let folder = folder();
    let [reference, image] = ["reference.exr", "a.exr"].map(|name| folder.path().join(name));
    render("--technique path --spp 1024 --seed 9", &[&reference]).assert_done();
    for technique in ["path", "two-pass", "shadow-photons"] {
        let arguments = format!("--noise 0.02 --technique {technique} --reference {}", reference.display());
        let answer = render(&arguments, &[&image]);
        answer.assert_done();
        let word = |text: &str, before: &str| -> f64 {
            text.split_once(before).unwrap().1.split_whitespace().next().unwrap().parse().unwrap()
        };
        let estimate = word(&answer.stderr, "estimated relMSE ");
        assert!(!answer.stderr.contains("was not reached"), "{}", answer.stderr);
        assert!(answer.stderr.contains(" of the raw image"), "{}", answer.stderr);
        let found = word(&answer.stdout, "relMSE ");
        // The reference and the map of indirect light add errors of their own.
        assert!(estimate <= 0.02 && found < 0.02, "{technique}: {found} for {estimate}");
        assert!(found > 0.02 / 40.0, "{technique}: {found} is more than the samples that were asked for");
        assert_eq!(channels(&Image::read(&image).unwrap()), ["A", "B", "G", "R"].into());
        let compared = run("compare", &[&image, &reference]);
        assert_eq!(answer.stdout, compared.assert_done().stdout);
    }
    let answer = render("--noise 1e-6 --technique path --spp 9", &[&image]);
    assert!(answer.assert_done().stderr.contains("a noise of 1e-6 was not reached everywhere: 6 of 6 blocks"));
    let answer = render("--noise 1e-6 --technique path --spp 1", &[&image]);
    assert!(answer.assert_done().stderr.contains("whether a noise of 1e-6 was reached is not known"));
}

/// A reference of another part of the image is refused before the render, as is a library that nothing would load.
#[test]
fn what_would_not_be_used_is_refused() {
    let folder = folder();
    let [reference, image] = ["reference.exr", "a.exr"].map(|name| folder.path().join(name));
    render("--spp 2 --crop 0,0,8,8", &[&reference]).assert_done();
    let with_reference =
        |more: &str| render(&format!("--spp 2 {more} --quiet --reference {}", reference.display()), &[&image]);
    with_reference("--crop 8,8,8,8").assert_refused(3, &["reference.exr", "another part of the image"]);
    with_reference("--crop 8,8,8,4").assert_refused(3, &["reference.exr", "needs a reference of that part"]);
    with_reference("").assert_refused(3, &["reference.exr", "set --width and --height"]);
    for more in ["", "--denoise statistical"] {
        let unused = render(&format!("{more} --oidn missing.so"), &[&image]);
        unused.assert_refused(2, &["--oidn missing.so", "--denoise auto"]);
    }
    assert!(!image.exists());
    with_reference("--crop 0,0,8,8").assert_done();
}

#[cfg(unix)]
mod stopped {
    use std::io::{BufRead, BufReader, Read};
    use std::process::Stdio;

    use super::*;
    use crate::program;

    /// Renders for an hour, but sends `signal` as soon as the render is under way.
    fn stop(signal: &str, image: &Path, statistics: &Path) -> Answer {
        let arguments = format!("render --device {} {SMALL} --time 3600", device());
        let mut child = penumbra(&arguments, &[&BOX, &"-o", &image, &"--stats", &statistics])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        while !said.contains("rendering") {
            assert!(stderr.read_line(&mut said).unwrap() > 0, "it ended before it began: {said}");
        }
        program::signal(&child, signal);
        stderr.read_to_string(&mut said).unwrap();
        let code = child.wait().unwrap().code();
        Answer { code, stdout: String::new(), stderr: said }
    }

    #[test]
    fn a_signal_ends_the_batch_and_what_there_is_is_written() {
        let folder = folder();
        for signal in ["-INT", "-TERM"] {
            let [image, file] = ["a.exr", "a.json"].map(|name| folder.path().join(format!("{signal}{name}")));
            let answer = stop(signal, &image, &file);
            assert_eq!(answer.code, Some(130), "{answer:?}");
            let written = format!("wrote {}", image.display());
            assert!(answer.stderr.contains("stopped after") && answer.stderr.contains(&written), "{answer:?}");
            let image = Image::read(&image).unwrap();
            assert!(image.channels.iter().all(|channel| channel.samples.iter().all(|x| x.is_finite())));
            let samples = read_json(&file)["samples"].as_u64().unwrap();
            assert!(samples >= 1);
            assert_eq!(image.metadata["samplesPerPixel"], Metadata::Int(samples as i32));
        }
    }
}

/// A render that must end at once uses `path`, says so in a note, and has one sample. A technique that the user names
/// is kept.
#[test]
fn a_short_time_is_for_paths() {
    let folder = folder();
    let [image, file] = ["a.png", "a.json"].map(|name| folder.path().join(name));
    let render = |arguments: &str| {
        let mut command =
            penumbra(&format!("render --device {} --width 24 --height 16 {arguments}", device()), &[&BOX]);
        let answer = Answer::of(command.arg("-o").arg(&image).arg("--stats").arg(&file));
        answer.assert_done();
        (read_json(&file), answer)
    };
    let (statistics, answer) = render("--time 0.001");
    assert_eq!(statistics["samples"], 1);
    // On a GPU photons and filters are fast.
    if statistics["device"]["kind"] == "software" {
        assert_eq!(statistics["settings"]["technique"], "path");
        assert!(answer.stderr.contains("using --technique path, because photons and records"), "{}", answer.stderr);
        assert!(answer.stderr.contains("denoising would take too much of --time 0.001"), "{}", answer.stderr);
    }
    // Nothing was measured on a GPU of how samples that are shared out compare at equal time.
    let shared = if statistics["device"]["kind"] == "software" { "adaptive" } else { "uniform" };
    let checkpoint = format!("--time 60 --spp 2 --checkpoint {}", folder.path().join("state").display());
    for (arguments, technique, sampling) in [
        ("--time 0.001 --technique two-pass", "two-pass", "uniform"),
        ("--time 60 --spp 2", "shadow-photons", shared),
        ("--time 60 --spp 2 --sampling uniform", "shadow-photons", "uniform"),
        (&*checkpoint, "shadow-photons", "uniform"),
        ("--time 60 --noise 0.1", "shadow-photons", "uniform"),
        ("--spp 2", "shadow-photons", "uniform"),
        ("--spp 2 --technique auto", "shadow-photons", "uniform"),
    ] {
        let settings = &render(arguments).0["settings"];
        assert_eq!(
            (&settings["technique"], &settings["sampling"]),
            (&technique.into(), &sampling.into()),
            "{arguments}"
        );
    }
}
