//! Sequences: frames of an animation, and sequences that are resumed.

use std::fs;
use std::path::{Path, PathBuf};

use penumbra::Image;
use penumbra::internal::render::film;
use serde_json::{Value, json};

use crate::program::{Answer, BOX, device, folder, run};

/// Quick settings.
const SMALL: &str = "--width 16 --height 12 --photons 4096 --max-bounces 0";

/// Its two animations are called `both` and `left`; the first has keys from 0.5 to 2 s.
const FACE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/scene/poses/face.gltf");

fn render(scene: &Path, arguments: &str, output: &Path) -> Answer {
    let arguments = format!("render --device {} {SMALL} --spp 2 {arguments}", device());
    run(&arguments, &[&scene, &"-o", &output])
}

fn sequence(arguments: &str, output: &Path) -> Answer {
    let answer = render(Path::new(FACE), &format!("--default-light {arguments}"), output);
    answer.assert_done();
    answer
}

fn bits(path: &Path) -> Vec<u32> {
    let image = Image::read(path).unwrap_or_else(|problem| panic!("{problem}"));
    image.channels.iter().flat_map(|channel| &channel.samples).map(|x| x.to_bits()).collect()
}

#[test]
fn frames_are_the_images_of_their_times() {
    let folder = folder();
    let name = folder.path().join("shot.{frame}.exr");
    let frame = |number: u32| folder.path().join(format!("shot.{number:04}.exr"));
    sequence("--frames 2..4 --fps 2", &name);
    let files: Vec<PathBuf> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 3, "{files:?}");
    assert_ne!(bits(&frame(2)), bits(&frame(3)));
    // Another seed for each frame.
    let seeded = folder.path().join("seeded.{frame}.exr");
    let single = folder.path().join("single.{frame}.exr");
    let third = |name: &str| folder.path().join(format!("{name}.0003.exr"));
    sequence("--frames 3..3 --fps 2 --seed 7 --seed-per-frame", &seeded);
    sequence("--frames 3..3 --fps 2 --seed 10", &single);
    assert_eq!(bits(&third("seeded")), bits(&third("single")));
    sequence("--frames 3..3 --fps 2 --seed 7", &single);
    assert_ne!(bits(&third("seeded")), bits(&third("single")));
    // Another animation, and one that repeats: 4.5 s are its 0.5 s, of an end at 2 s.
    let (a, b) = (folder.path().join("a.exr"), folder.path().join("b.exr"));
    sequence("--at 4.5 --animation left --loop", &a);
    sequence("--at 0.5 --animation 1", &b);
    assert_eq!(bits(&a), bits(&b));
}

/// The file has no camera. All frames have the one that frames the beginning of the animation, whichever frames a
/// process renders: a farm gives each process some of them. At a single moment the camera frames that moment.
#[test]
fn frames_have_one_camera_whichever_are_rendered() {
    let folder = folder();
    let file = |name: &str, number: u32| folder.path().join(format!("{name}.{number:04}.exr"));
    let rendered = |name: &str, frames: &str| {
        sequence(&format!("--frames {frames} --fps 2"), &folder.path().join(format!("{name}.{{frame}}.exr")));
    };
    rendered("whole", "0..3");
    rendered("part", "2..3");
    for frame in 2..4 {
        assert_eq!(bits(&file("part", frame)), bits(&file("whole", frame)), "frame {frame}");
    }
    let moment = |time: &str| {
        let single = folder.path().join("single.exr");
        sequence(&format!("--at {time}"), &single);
        bits(&single)
    };
    assert_eq!(bits(&file("whole", 0)), moment("0"));
    assert_ne!(bits(&file("whole", 3)), moment("1.5"));
}

/// The views of a turntable are files of their own, each of another side, and complete ones are skipped.
#[test]
fn turntables_show_all_sides() {
    let folder = folder();
    let view = |name: &str, number: u32| folder.path().join(format!("{name}.{number:04}.exr"));
    let name = |name: &str| folder.path().join(format!("{name}.{{frame}}.exr"));
    let both = sequence("--turntable 2 --from 30,20", &name("both"));
    assert!(!view("both", 2).exists(), "{}", both.stderr);
    assert_ne!(bits(&view("both", 0)), bits(&view("both", 1)));
    let again = sequence("--turntable 2 --from 30,20", &name("both"));
    assert!((0..2).all(|i| again.stderr.contains(&format!("view {i} is complete"))), "{}", again.stderr);
}

/// The statistics of a frame have its own notes, such as how many blocks are too noisy, whichever other frames the
/// process renders.
#[test]
fn notes_of_a_frame_are_its_own() {
    let folder = folder();
    let [name, statistics] = ["shot.{frame}.png", "shot.{frame}.json"].map(|name| folder.path().join(name));
    let file = |number: u32| folder.path().join(format!("shot.{number:04}.json"));
    let notes = |frames: &str| {
        let noisy = "--denoise none --noise 0.001 --spp 4 --width 64 --height 48 --max-bounces 0 --default-light";
        let arguments = format!("render --device {} {noisy} --fps 2 --frames {frames}", device());
        run(&arguments, &[&FACE, &"-o", &name, &"--stats", &statistics]).assert_done();
        let text = fs::read_to_string(file(1)).unwrap();
        serde_json::from_str::<Value>(&text).unwrap()["notes"].to_string()
    };
    let both = notes("0..1");
    assert_eq!(both.matches("was not reached everywhere").count(), 1, "{both}");
    fs::remove_file(file(1)).unwrap();
    assert_eq!(notes("1..1"), both);
}

/// The name of a frame does not depend on the other frames.
#[test]
fn names_of_frames_are_those_of_other_ranges() {
    let folder = folder();
    sequence("--frames 9999..10000 --fps 10000", &folder.path().join("{frame}.exr"));
    for name in ["9999.exr", "10000.exr"] {
        assert!(folder.path().join(name).exists(), "{name}");
    }
}

/// Frames after the first are rendered with its kernels, and have the bits of a render of their own.
#[test]
fn later_frames_are_those_of_a_process_of_their_own() {
    let folder = folder();
    let scene = folder.path().join("seen.gltf");
    let mut json: Value = serde_json::from_slice(&fs::read(FACE).unwrap()).unwrap();
    json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.8, "znear": 0.1 } }]);
    json["nodes"].as_array_mut().unwrap().push(json!({ "camera": 0, "translation": [6, 3, 20] }));
    json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(2));
    fs::write(&scene, json.to_string()).unwrap();
    let name = folder.path().join("shot.{frame}.exr");
    let arguments = "--default-light --animation both";
    render(&scene, &format!("{arguments} --frames 1..3 --fps 2"), &name).assert_done();
    for (frame, time) in [(1, 0.5), (2, 1.0), (3, 1.5)] {
        let single = folder.path().join("single.exr");
        render(&scene, &format!("{arguments} --at {time}"), &single).assert_done();
        assert_eq!(bits(&folder.path().join(format!("shot.{frame:04}.exr"))), bits(&single), "frame {frame}");
    }
}

#[test]
fn an_interrupted_sequence_goes_on_where_it_stopped() {
    let folder = folder();
    let name = folder.path().join("shot.{frame}.png");
    let file = |number: u32| folder.path().join(format!("shot.{number:04}.png"));
    let arguments = "--denoise none --fps 2";
    sequence(&format!("--frames 0..4 {arguments}"), &name);
    let whole: Vec<Vec<u8>> = (0..5).map(|i| fs::read(file(i)).unwrap()).collect();
    // Complete, missing, cut, without its fingerprint, and of another image.
    let unsigned = film_of(&file(3));
    fs::remove_file(file(1)).unwrap();
    fs::write(file(2), &whole[2][..whole[2].len() - 40]).unwrap();
    unsigned.write_png(file(3), film::View::default(), 0.0).unwrap();
    fs::copy(file(0), file(4)).unwrap();
    let again = sequence(&format!("--frames 0..4 {arguments}"), &name);
    let complete =
        |answer: &Answer| (0..5).map(|i| answer.stderr.contains(&format!("frame {i} is complete"))).collect();
    let found: Vec<bool> = complete(&again);
    assert_eq!(found, [true, false, false, false, false], "{}", again.stderr);
    assert!((0..5).all(|i| fs::read(file(i)).unwrap() == whole[i as usize]), "other bits than without the break");
    let found: Vec<bool> = complete(&sequence(&format!("--frames 0..4 {arguments}"), &name));
    assert_eq!(found, [true; 5]);
    // Other settings, another view and another scene make other frames.
    for other in ["--seed 1", "--exposure 1", "--view agx", "--animation left"] {
        let found: Vec<bool> = complete(&sequence(&format!("--frames 0..0 {arguments} {other}"), &name));
        assert!(!found[0], "{other}");
    }
}

fn film_of(path: &Path) -> Image {
    let mut image = Image::read(path).unwrap();
    assert!(film::fingerprint(path).is_some());
    image.metadata.clear();
    image
}

/// A signal ends the frame, which is not written: any file that exists is complete.
#[cfg(unix)]
#[test]
fn a_signal_leaves_complete_frames() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::Stdio;

    use crate::program::{penumbra, signal};

    let folder = folder();
    let name = folder.path().join("shot.{frame}.png");
    let arguments =
        format!("render --device {} {SMALL} --spp 16384 --default-light --frames 0..999 --time 1000", device());
    let mut child = penumbra(&arguments, &[&FACE, &"-o", &name]).stderr(Stdio::piped()).spawn().unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut said = String::new();
    while !said.contains("rendering") {
        assert!(stderr.read_line(&mut said).unwrap() > 0, "it ended before it began: {said}");
    }
    signal(&child, "-INT");
    stderr.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "{said}");
}

/// No frame overwrites an input, however many frames there are. Digits beside {frame} are part of the name.
#[test]
fn no_frame_overwrites_an_input() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let panorama = path("sky10005.exr");
    fs::write(&panorama, "kept").unwrap();
    for (output, frames) in [
        ("sky{frame}.exr", "0..4294967295"),
        ("sky1{frame}.exr", "0..9"),
        ("sky1{frame}.exr", "5..5"),
        ("sky{frame}5.exr", "1000..1001"),
    ] {
        let arguments = format!("render --device {} --frames {frames} --environment", device());
        run(&arguments, &[&panorama, &FACE, &"-o", &path(output)])
            .assert_refused(2, &["sky10005.exr", "would be overwritten"]);
    }
    // A model among the views of a turntable.
    let model = path("view0002.exr");
    run("render --turntable 3 -o", &[&path("view{frame}.exr"), &model]).assert_refused(2, &["view0002.exr"]);
    assert_eq!(fs::read(&panorama).unwrap(), b"kept");
}

/// No frame of an output overwrites another frame of another output.
#[test]
fn no_frame_overwrites_one_of_another_output() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let refused = |[one, other]: [&str; 2], frames: &str| {
        let arguments = format!("render --device {} --frames {frames} -o", device());
        run(&arguments, &[&path(one), &"-o", &path(other), &"no-scene.glb"])
    };
    for (names, frames, shared) in [
        (["1{frame}.exr", "{frame}.exr"], "11..10011", ["10011.exr", "frame 10011"]),
        (["{frame}.exr", "1{frame}.exr"], "0..4294967295", ["10000.exr", "frame 10000"]),
        (["{frame}1.exr", "1{frame}.exr"], "1111..1111", ["11111.exr", "frame 1111"]),
        (["{frame}.exr", "{frame}{frame}.exr"], "1000..10001000", ["10001000.exr", "frame 10001000"]),
        (["a/.././1{frame}.exr", "a/../{frame}.exr"], "11..10011", ["10011.exr", "frame 10011"]),
    ] {
        refused(names, frames).assert_refused(2, &shared);
    }
    // These go on to the scene, which is not there.
    for (names, frames) in [
        (["1{frame}.exr", "{frame}.exr"], "0..9999"),
        (["1{frame}.exr", "{frame}.exr"], "12..10011"),
        (["1{frame}.exr", "{frame}.png"], "0..4294967295"),
        (["a{frame}.exr", "b{frame}.exr"], "0..4294967295"),
    ] {
        refused(names, frames).assert_refused(3, &["no-scene.glb"]);
    }
}

/// The number of a frame cannot be put into a name that is not UTF-8: all frames would go to one file.
#[cfg(unix)]
#[test]
fn names_of_frames_are_utf8() {
    use std::os::unix::ffi::OsStrExt;
    let output = std::ffi::OsStr::from_bytes(b"shot\xff.{frame}.png");
    run("render no-scene.glb --frames 0..3 -o", &[&output]).assert_refused(2, &["--frames", "UTF-8"]);
}

#[test]
fn wrong_usage_of_time_names_the_option() {
    for (arguments, word) in [
        ("render no-scene.glb -o shot.png --frames 0..3", "{frame}"),
        ("SEQUENCE -o all.exr --frames 0..3", "all.exr"),
        ("SEQUENCE --stats all.json --frames 0..3", "all.json"),
        ("SEQUENCE --frames 3..0", "--frames"),
        ("SEQUENCE --frames 3", "--frames"),
        ("SEQUENCE --frames x..2", "--frames"),
        ("SEQUENCE --frames 0..3 --fps 0", "--fps"),
        ("SEQUENCE --frames 0..3 --at 1", "--at"),
        ("SEQUENCE --frames 0..3 --checkpoint x", "--checkpoint"),
        ("SEQUENCE --fps 3", "--frames"),
        ("SEQUENCE --seed-per-frame", "--frames"),
        ("SEQUENCE --turntable 0", "--turntable"),
        ("SEQUENCE --turntable 4294967295", "--turntable"),
        ("SEQUENCE --turntable 3 --frames 0..3", "--frames"),
        ("SEQUENCE --turntable 3 --camera 0", "--camera"),
        ("SEQUENCE --turntable 3 --checkpoint x", "--checkpoint"),
        ("render no-scene.glb -o shot.png --turntable 3", "--turntable"),
        ("SEQUENCE --at nan", "--at"),
        ("SEQUENCE --animation run", "--at"),
        ("SEQUENCE --loop", "--at"),
        ("plan no-scene.glb --loop", "--at"),
        ("plan no-scene.glb --frames 0..3", "--frames"),
    ] {
        let arguments = arguments.replace("SEQUENCE", "render no-scene.glb -o shot.{frame}.png");
        run(&arguments, &[]).assert_refused(2, &[word]);
    }
    run("plan --at 1", &[&BOX]).assert_refused(2, &["no animation", "--at"]);
    let frames = format!("render --device {} -o {{frame}}.png --frames 0..1", device());
    run(&frames, &[&BOX]).assert_refused(2, &["no animation", "--frames has"]);
    run("plan --at 1 --animation jump", &[&FACE]).assert_refused(2, &["jump", "both, left"]);
}
