//! `penumbra check`: image regression tests, and those of `scenes/`.

use std::fs;
use std::path::Path;

use penumbra::Image;

use crate::program::{Answer, BOX, device, folder, penumbra};

/// Runs the cases of a file; the page goes beside them.
fn check(cases: &Path, arguments: &str) -> Answer {
    let mut command = penumbra(&format!("check {arguments} --html"), &[]);
    Answer::of(command.arg(cases.with_extension("html")).arg(cases))
}

fn on_device(arguments: &str) -> String {
    format!("--device {} {arguments}", device())
}

/// The scenes of the repository look as they did. Another kind of device than lavapipe has no baselines.
#[test]
fn the_scenes_look_as_they_did() {
    if device() != "software" {
        println!("left out: the baselines are of lavapipe");
        return;
    }
    let folder = folder();
    let cases = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/check/CASES.toml");
    let page = folder.path().join("check.html");
    let mut command = penumbra(&format!("check --device software {cases} --html"), &[&page]);
    let answer = Answer::of(&mut command);
    assert_eq!(answer.code, Some(0), "{}\n{}", answer.stdout, answer.stderr);
    assert!(!answer.stderr.contains("no case uses"), "{answer:?}");
    let page = fs::read_to_string(&page).unwrap();
    // It needs no other file.
    assert!(page.contains("data:image/png;base64,"));
    for outside in ["http://", "https://", "src=\"/", "<link", "<script"] {
        assert!(!page.contains(outside), "{outside}");
    }
}

#[test]
fn baselines_are_made_and_compared() {
    let folder = folder();
    let file = folder.path().join("CASES.toml");
    let write = |light: f32| {
        let text = format!(
            "[render]\nwidth = 24\nheight = 16\nspp = 2\nmax-bounces = 0\ntechnique = \"path\"\n\
             [[case]]\nname = \"usual\"\nscene = \"{BOX}\"\n\
             [[case]]\nname = \"bright\"\nscene = \"{BOX}\"\nrender = {{ light-scale = {light:?} }}\n"
        );
        fs::write(&file, text).unwrap();
    };
    write(1.0);
    // Without baselines.
    let answer = check(&file, &on_device(""));
    assert_eq!(answer.code, Some(5), "{answer:?}");
    assert!(answer.stdout.contains("broken   usual") && answer.stdout.contains("--bless usual makes it"), "{answer:?}");
    // Only the requested baseline is made.
    assert_eq!(check(&file, &on_device("--bless usual")).code, Some(5));
    let baseline = |name: &str| folder.path().join("baselines").join(name);
    assert!(baseline("usual.exr").exists() && !baseline("bright.exr").exists());
    check(&file, &on_device("--bless all")).assert_done();
    let answer = check(&file, &on_device("--twice --jobs 2"));
    answer.assert_done();
    assert!(answer.stdout.contains("passed   bright"), "{answer:?}");
    let page = fs::read_to_string(file.with_extension("html")).unwrap();
    assert!(page.contains("2 of 2 cases passed"));
    assert!(page.contains("pixels that differ between two runs</th><td>0</td>"));
    // The command that it shows makes the image.
    let shown = page.split("<code>penumbra ").nth(1).and_then(|rest| rest.split("</code>").next()).unwrap();
    assert!(shown.ends_with("-o usual.exr"), "{shown}");
    Answer::of(penumbra(shown, &[]).current_dir(folder.path())).assert_done();
    let [made, blessed] =
        [folder.path().join("usual.exr"), baseline("usual.exr")].map(|path| Image::read(path).unwrap());
    assert!(made.rgb() == blessed.rgb());
    // The light of one changes, and its baseline stays.
    write(1.5);
    let before = fs::read(baseline("bright.exr")).unwrap();
    let xml = folder.path().join("check.xml");
    let answer = check(&file, &on_device(&format!("--junit {}", xml.display())));
    assert_eq!(answer.code, Some(5), "{answer:?}");
    assert!(answer.stdout.contains("passed   usual") && answer.stdout.contains("failed   bright"), "{answer:?}");
    assert!(answer.stderr.contains("1 of 2 cases passed"), "{answer:?}");
    assert!(answer.stdout.contains("relMSE is"), "{answer:?}");
    assert!(before == fs::read(baseline("bright.exr")).unwrap());
    let xml = fs::read_to_string(&xml).unwrap();
    assert!(
        xml.contains("tests=\"2\" failures=\"1\" errors=\"0\"") && xml.contains("<failure message=\"relMSE is"),
        "{xml}"
    );
    check(&file, &on_device("--only usual")).assert_done();
    // Baselines of another size, of another device, and that no case uses.
    let mut other = Image::read(baseline("usual.exr")).unwrap();
    other.metadata.insert("penumbra:device".into(), penumbra::Metadata::Text("Other GPU".into()));
    other.write_exr(baseline("usual.exr")).unwrap();
    Image::read_exr(BOX.replace("box.glb", "sky.exr")).unwrap().write_exr(baseline("bright.exr")).unwrap();
    fs::write(baseline("old.exr"), "").unwrap();
    let answer = check(&file, &on_device(""));
    assert_eq!(answer.code, Some(5), "{answer:?}");
    assert!(answer.stdout.contains("the baseline is of the device Other GPU, but the image is of"), "{answer:?}");
    assert!(answer.stdout.contains("its size is 24 x 16 pixels, that of the reference"), "{answer:?}");
    assert!(answer.stderr.contains("no case uses the baseline") && answer.stderr.contains("old.exr"), "{answer:?}");
    let answer = check(&file, &on_device("--only usual --bless usual"));
    assert!(answer.stdout.contains("no new baseline: the baselines are of the device Other GPU"), "{answer:?}");
    // A device that the file does not name, none at all, and a name that no case has.
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, format!("device = \"Other GPU\"\n{text}")).unwrap();
    check(&file, &on_device("")).assert_refused(3, &["CASES.toml", "the baselines are of Other GPU"]);
    check(&file, "--device none-of-these").assert_refused(4, &["none-of-these"]);
    check(&file, "--only none").assert_refused(2, &["is called 'none'"]);
}

/// A PNG has eight bits and nothing brighter than white, as in a lamp: compared in that form, an image is what it was.
/// A format that is not written leaves the case broken, and the others get their baselines.
#[test]
fn baselines_have_other_formats() {
    let folder = folder();
    let file = folder.path().join("CASES.toml");
    let case = |name: &str| format!("[[case]]\nname = \"{name}\"\nscene = \"{BOX}\"\nbaseline = \"{name}\"\n");
    let cases = ["a.hdr", "b.png", "c.exr"].map(case).concat();
    let render = "[render]\nwidth = 24\nheight = 24\nspp = 2\nmax-bounces = 0\ntechnique = \"path\"\n";
    fs::write(&file, format!("{render}{cases}")).unwrap();
    let answer = check(&file, &on_device("--bless all"));
    assert_eq!(answer.code, Some(5), "{answer:?}");
    assert!(answer.stdout.contains("broken   a.hdr") && answer.stdout.contains("no new baseline: "), "{answer:?}");
    assert!(answer.stdout.contains("written as .exr or .png"), "{answer:?}");
    let lamp = Image::read(folder.path().join("baselines/c.exr")).unwrap();
    assert!(lamp.channel("R").unwrap().iter().any(|x| *x > 2.0), "no pixel is brighter than white");
    let exact = "[limits]\nrelmse = 0.0\nflip = 0.0\nchanged = 0.0\n";
    fs::write(&file, format!("{render}{exact}{cases}")).unwrap();
    check(&file, &on_device("--only b.png --only c.exr")).assert_done();
    fs::write(&file, format!("{render}light-scale = 1.1\n{exact}{cases}")).unwrap();
    let answer = check(&file, &on_device("--only b.png"));
    assert!(answer.code == Some(5) && answer.stdout.contains("failed   b.png"), "{answer:?}");
}

/// A scene that cannot be rendered is a broken case, and the others run.
#[test]
fn a_render_that_fails_is_a_broken_case() {
    let folder = folder();
    let file = folder.path().join("CASES.toml");
    fs::write(&file, "[[case]]\nname = \"none\"\nscene = \"none.glb\"\n").unwrap();
    let answer = check(&file, &on_device(""));
    assert_eq!(answer.code, Some(5), "{answer:?}");
    assert!(answer.stdout.contains("broken   none") && answer.stdout.contains("none.glb"), "{answer:?}");
}

/// A render that takes too long is ended and named, and the others continue. This one would take days.
#[test]
fn a_render_that_takes_too_long_is_a_broken_case() {
    let folder = folder();
    let file = folder.path().join("CASES.toml");
    let text = format!(
        "[[case]]\nname = \"endless\"\nscene = \"{BOX}\"\nrender = {{ technique = \"path\", spp = 10000000 }}\n\
         limits = {{ seconds = 0.25 }}\n[[case]]\nname = \"none\"\nscene = \"none.glb\"\n"
    );
    fs::write(&file, text).unwrap();
    let answer = check(&file, &on_device(""));
    assert_eq!(answer.code, Some(5), "{answer:?}");
    assert!(answer.stdout.contains("broken   endless"), "{answer:?}");
    assert!(answer.stdout.contains("took longer than its limit `seconds`, 0.25 s"), "{answer:?}");
    assert!(answer.stdout.contains("broken   none"), "{answer:?}");
}

/// A signal ends the renders, which would go on alone, and leaves no folder for temporary files.
#[cfg(target_os = "linux")]
#[test]
fn a_signal_ends_the_renders_too() {
    use std::thread::sleep;
    use std::time::{Duration, Instant};

    let folder = folder();
    let file = folder.path().join("CASES.toml");
    let endless = "render = { technique = \"path\", spp = 10000000 }";
    fs::write(&file, format!("[[case]]\nname = \"endless\"\nscene = \"{BOX}\"\n{endless}\n")).unwrap();
    let temporary = folder.path().join("temporary");
    fs::create_dir(&temporary).unwrap();
    // The processes that name the folder in their arguments: the renders write to it.
    let renders = || {
        let name = temporary.to_string_lossy();
        let commands =
            fs::read_dir("/proc").unwrap().filter_map(|entry| fs::read(entry.ok()?.path().join("cmdline")).ok());
        commands.filter(|command| String::from_utf8_lossy(command).contains(&*name)).count()
    };
    for (name, code) in [("-TERM", 130), ("-INT", 130)] {
        let mut command =
            penumbra(&format!("check --device {}", device()), &[&"--html", &file.with_extension("html"), &file]);
        let child = command.env("TMPDIR", &temporary).stderr(std::process::Stdio::piped()).spawn().unwrap();
        let start = Instant::now();
        while renders() == 0 {
            assert!(start.elapsed() < Duration::from_secs(60), "no render begins");
            sleep(Duration::from_millis(10));
        }
        crate::program::signal(&child, name);
        let answer = Answer::from(child.wait_with_output().unwrap());
        assert_eq!((answer.code, answer.stderr.as_str()), (Some(code), "stopped; nothing is written\n"));
        assert_eq!(renders(), 0, "{name}: the render goes on");
        assert_eq!(fs::read_dir(&temporary).unwrap().count(), 0, "{name}: a folder is left");
    }
}

/// What would be ignored, or make cases overwrite each other's baselines, is refused.
#[test]
fn contradictions_are_refused() {
    let folder = folder();
    let file = folder.path().join("CASES.toml");
    let case = |name: &str, rest: &str| format!("[[case]]\nname = \"{name}\"\nscene = \"{BOX}\"\n{rest}");
    fs::write(&file, case("a", "") + &case("b", "")).unwrap();
    check(&file, &on_device("--only b --bless a")).assert_refused(2, &["--bless a", "--only a"]);
    fs::write(&file, case("a", "") + &case("b", "baseline = \"./a.exr\"\n")).unwrap();
    check(&file, &on_device("")).assert_refused(3, &["case b", "a.exr", "case a has too"]);
}

/// Images of other renderers need no device.
#[test]
fn images_of_other_renderers_are_compared() {
    let folder = folder();
    let file = folder.path().join("CASES.toml");
    fs::write(&file, "[[case]]\nname = \"a\"\n[[case]]\nname = \"b\"\nbaseline = \"b.png\"\n").unwrap();
    let images = folder.path().join("images");
    fs::create_dir(&images).unwrap();
    let mut image = Image::new(4, 3);
    for (channel, value) in [("R", 0.1), ("G", 0.5), ("B", 0.9)] {
        image.add_channel(channel, vec![value; 12]);
    }
    image.write_exr(images.join("a.exr")).unwrap();
    let arguments = format!("--images {}", images.display());
    let answer = check(&file, &arguments);
    let is_named = answer.stdout.contains("b.exr, .png or .hdr");
    assert!(answer.stdout.contains("there is no baseline") && is_named, "{answer:?}");
    image.write_png(images.join("b.png"), penumbra::View::Standard, 0.0).unwrap();
    check(&file, &format!("{arguments} --bless all")).assert_done();
    check(&file, &arguments).assert_done();
    image.add_channel("G", vec![0.6; 12]);
    image.write_exr(images.join("a.exr")).unwrap();
    let answer = check(&file, &arguments);
    assert_eq!(answer.code, Some(5), "{answer:?}");
    assert!(answer.stdout.contains("failed   a") && answer.stdout.contains("passed   b"), "{answer:?}");
    // An image without colours is a broken case, and the others are on the page.
    let mut grey = Image::new(4, 3);
    grey.add_channel("Y", vec![0.5; 12]);
    grey.write_exr(images.join("a.exr")).unwrap();
    let answer = check(&file, &arguments);
    assert_eq!(answer.code, Some(5), "{answer:?}");
    let is_named = answer.stdout.contains("a.exr: R: there is no such channel");
    assert!(is_named && answer.stdout.contains("passed   b"), "{answer:?}");
    assert!(fs::read_to_string(file.with_extension("html")).unwrap().contains("1 broken"));
    // Cases without a scene cannot be rendered.
    check(&file, &on_device("")).assert_refused(3, &["case a", "--images"]);
}
