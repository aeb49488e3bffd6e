//! Help, versions, and wrong usage: exit code 2 and one line that names the option.

use std::ffi::OsStr;

use penumbra::{Aov, Settings, Technique};

use crate::program::{Answer, BOX, folder, penumbra, run};

#[test]
fn help_and_version_are_answers() {
    let version = run("--version", &[]);
    assert_eq!(version.assert_done().stdout, concat!("penumbra ", env!("CARGO_PKG_VERSION"), "\n"));
    for arguments in
        ["--help", "help", "render --help", "plan -h", "devices --help", "compare --help", "report --help", "table1 -h"]
    {
        let answer = run(arguments, &[]);
        answer.assert_done();
        assert!(answer.stdout.contains("Usage: penumbra") && answer.stderr.is_empty(), "{answer:?}");
    }
}

#[test]
fn no_command_shows_the_help() {
    let answer = run("", &[]);
    assert_eq!(answer.code, Some(2));
    assert!(answer.stderr.contains("Usage: penumbra <COMMAND>"), "{answer:?}");
}

/// The help text of an option of `render`, on one line.
fn help_of(option: &str) -> String {
    let help = run("render --help", &[]).stdout;
    let lines = help.lines().skip_while(|line| !line.contains(option));
    let text: Vec<_> = lines.enumerate().take_while(|(i, line)| *i == 0 || !line.contains("  --")).collect();
    text.into_iter().flat_map(|(_, line)| line.split_whitespace()).collect::<Vec<_>>().join(" ")
}

#[test]
fn help_states_the_defaults_and_names() {
    let (height, spp, seed, photons, nearest, shadow_photons_per_ray) = (
        Settings::default().image.height,
        Settings::default().image.spp,
        Settings::default().image.seed,
        Settings::default().photons_per_light(),
        Settings::default().visibility_map.nearest,
        Settings::default().visibility_map.shadow_photons_per_ray,
    );
    let (shadow_samples, audit, max_bounces, light_scale) = (
        Settings::default().shadow_rays.samples,
        Settings::default().visibility_map.audit,
        Settings::default().indirect.max_bounces,
        Settings::default().light_scale,
    );
    let (cells, cell_rays, shadow_tolerance) = (
        Settings::default().cells.resolution,
        Settings::default().cells.rays_per_light,
        Settings::default().ward.tolerance,
    );
    for (option, default) in [
        ("--technique <", "auto".to_owned()),
        ("--height <", height.to_string()),
        ("--spp <", spp.to_string()),
        ("--seed <", seed.to_string()),
        ("--photons <", photons.to_string()),
        ("--nearest <", nearest.to_string()),
        ("--shadow-photons-per-ray <", shadow_photons_per_ray.to_string()),
        ("--shadow-samples <", shadow_samples.to_string()),
        ("--audit <", audit.to_string()),
        ("--max-bounces <", max_bounces.to_string()),
        ("--light-scale <", light_scale.to_string()),
        ("--cells <", cells.to_string()),
        ("--cell-rays <", cell_rays.to_string()),
        ("--shadow-tolerance <", shadow_tolerance.to_string()),
        ("--light-buffer-cells <", Settings::default().light_buffer.resolution.to_string()),
        ("--sampled-lights <", Settings::default().light_sampling.sampled_lights.to_string()),
    ] {
        let help = help_of(option);
        assert!(help.contains(&format!("[default: {default}")), "{help}");
    }
    assert!(help_of("--clamp <").contains("from the caustic map is not limited"));
    let (techniques, aovs) = (help_of("--technique <"), help_of("--aov <"));
    assert!(Technique::all().all(|technique| techniques.contains(technique.name())), "{techniques}");
    assert!(Aov::ALL.iter().all(|aov| aovs.contains(aov.name())), "{aovs}");
}

#[test]
fn wrong_usage_names_the_option() {
    // No file is opened before usage is checked: the scene is not there.
    for (arguments, word) in [
        ("render no-scene.glb", "--output"),
        ("render -o x.png", "<SCENE>"),
        ("render no-scene.glb -o x.tiff", "x.tiff"),
        ("render no-scene.glb -o x", ".exr or .png"),
        ("render no-scene.glb -o x.png -o y.jpg", "y.jpg"),
        ("render no-scene.glb -o x.png --widht 3", "--widht"),
        ("render no-scene.glb -o x.png --width 0", "--width"),
        ("render no-scene.glb -o x.png --width -1", "--width"),
        ("render no-scene.glb -o x.png --width 16385", "--width"),
        ("render no-scene.glb -o x.png --width 1e3", "--width"),
        ("render no-scene.glb -o x.png --width 4294967296", "--width"),
        ("render no-scene.glb -o x.png --height 0", "--height"),
        ("render no-scene.glb -o x.png --spp 0", "--spp"),
        ("render no-scene.glb -o x.png --spp 16777217", "--spp"),
        ("render no-scene.glb -o x.png --spp", "--spp"),
        ("render no-scene.glb -o x.png --seed x", "--seed"),
        ("render no-scene.glb -o x.png --technique radiosity", "radiosity"),
        ("render no-scene.glb -o x.png --photons 0", "--photons"),
        ("render no-scene.glb -o x.png --nearest 0", "--nearest"),
        ("render no-scene.glb -o x.png --nearest 512", "--nearest"),
        ("render no-scene.glb -o x.png --shadow-photons-per-ray 0", "--shadow-photons-per-ray"),
        ("render no-scene.glb -o x.png --shadow-samples 0", "--shadow-samples"),
        ("render no-scene.glb -o x.png --dilate 2", "--dilate"),
        ("render no-scene.glb -o x.png --audit 1.5", "--audit"),
        ("render no-scene.glb -o x.png --audit nan", "--audit"),
        ("render no-scene.glb -o x.png --cells 257", "--cells"),
        ("render no-scene.glb -o x.png --light-buffer-cells 257", "--light-buffer-cells"),
        ("render no-scene.glb -o x.png --light-sampling contribution --technique path", "--light-sampling"),
        ("render no-scene.glb -o x.png --light-sampling contribution --technique light-buffer", "--light-sampling"),
        ("render no-scene.glb -o x.png --light-sampling some", "--light-sampling"),
        ("render no-scene.glb -o x.png --light-sampling zones --technique path", "--light-sampling"),
        ("render no-scene.glb -o x.png --light-sampling all --technique path", "--light-sampling"),
        ("render no-scene.glb -o x.png --light-sampling zones --technique two-pass", "--light-sampling"),
        ("render no-scene.glb -o x.png --light-sampling zones --technique visibility-estimate", "--light-sampling"),
        ("render no-scene.glb -o x.png --light-sampling power --technique voxel-tags", "--light-sampling"),
        ("render no-scene.glb -o x.exr --light-sampling power --aov shadow", "--light-sampling"),
        ("render no-scene.glb -o x.png --sampled-lights 1", "--sampled-lights"),
        ("render no-scene.glb -o x.png --technique two-pass --sampled-lights 0", "--sampled-lights"),
        ("render no-scene.glb -o x.png --sampled-lights 65", "--sampled-lights"),
        ("render no-scene.glb -o x.png --cell-rays 0", "--cell-rays"),
        ("render no-scene.glb -o x.png --shadow-tolerance nan", "--shadow-tolerance"),
        ("render no-scene.glb -o x.png --light-scale -1", "--light-scale"),
        ("render no-scene.glb -o x.png --light-scale inf", "--light-scale"),
        ("render no-scene.glb -o x.exr --aov beauty", "beauty"),
        ("render no-scene.glb -o x.exr --aov N,,Z", "--aov"),
        ("render no-scene.glb -o x.png --aov N", "--aov"),
        ("render no-scene.glb -o x.png --view filmic", "filmic"),
        ("render no-scene.glb -o x.png --exposure nan", "--exposure"),
        ("render no-scene.glb -o x.png --time 0", "--time"),
        ("render no-scene.glb -o x.png --time -1", "--time"),
        ("render no-scene.glb -o x.png --time inf", "--time"),
        ("render no-scene.glb -o x.{frame}.png", "add --frames or --turntable"),
        ("render no-scene.glb -o x.png --noise 0", "--noise"),
        ("render no-scene.glb -o x.png --noise 0.1 --technique visibility-estimate", "--noise"),
        ("render no-scene.glb -o x.png --noise 0.1 --audit 0", "--noise"),
        ("render no-scene.glb -o x.png --resume", "--checkpoint"),
        ("render no-scene.glb -o x.png --crop -1,0,2,2", "four whole numbers"),
        ("render no-scene.glb -o x.png --background -1,0,0", "0 or more"),
        ("render no-scene.glb -o x{frame}.png --frames -1..2", "--frames"),
        ("plan", "<SCENE>"),
        ("plan no-scene.glb --nearest 0", "--nearest"),
        ("plan no-scene.glb -o x.png", "-o"),
        ("compare a.exr", "<REFERENCE>"),
        ("compare a.exr b.exr --max-relmse -1", "--max-relmse"),
        ("compare a.exr b.exr --max-relmse nan", "--max-relmse"),
        ("report no-scene.glb", "--output"),
        ("report no-scene.glb -o x --techniques path,radiosity", "radiosity"),
        ("report no-scene.glb -o x --techniques radiosity+auto", "[possible values: auto, path, two-pass"),
        ("report no-scene.glb -o x --techniques path,path+oidm", "[possible values: auto, statistical, oidn]"),
        ("report no-scene.glb -o x --techniques path+none", "[possible values: auto, statistical, oidn]"),
        ("report no-scene.glb -o x --techniques path+oidn+auto", "[possible values: auto, statistical, oidn]"),
        ("report no-scene.glb -o x --techniques path+", "[possible values: auto, statistical, oidn]"),
        ("report no-scene.glb -o x --budgets 1,0", "--budgets"),
        ("report no-scene.glb -o x --budgets 1,,2", "--budgets"),
        ("report no-scene.glb -o x --repeats 2", "--repeats"),
        ("report no-scene.glb -o x --reference-error 0", "--reference-error"),
        ("report no-scene.glb -o x --sweep photons", "--sweep"),
        ("report no-scene.glb -o x --sweep photons=9..3", "--sweep"),
        ("report no-scene.glb -o x --sweep k=1..9", "--sweep"),
        ("report no-scene.glb -o x --width 0", "--width"),
        ("devices now", "now"),
        ("table1 --width 0", "--width"),
        ("table1 --spp 0", "--spp"),
        ("render no-scene.glb -o x.png --spp 1.5", "it must be a whole number"),
        ("table1 sphere.glb", "sphere.glb"),
        ("paint", "paint"),
    ] {
        run(arguments, &[]).assert_refused(2, &[word]);
    }
}

/// Two spellings of one path are one file, and one of the two outputs would be lost.
#[test]
fn outputs_do_not_overwrite_each_other() {
    let folder = folder();
    let picture = folder.path().join("picture.png");
    let again = folder.path().join(".").join("picture.png");
    let refuse = |option: &str| {
        let arguments: [&dyn AsRef<OsStr>; 5] = [&BOX, &"-o", &picture, &option, &again];
        run("render", &arguments).assert_refused(2, &["picture.png", "twice"]);
    };
    ["-o", "--stats", "--checkpoint"].into_iter().for_each(refuse);
    let scene = folder.path().join("scene.glb");
    std::fs::copy(BOX, &scene).unwrap();
    run("render", &[&scene, &"-o", &picture, &"--stats", &scene])
        .assert_refused(2, &["scene.glb", "would be overwritten"]);
}

/// A panorama, a reference, what a scene refers to, pieces, and the scenes and baselines of cases.
#[test]
fn outputs_do_not_overwrite_inputs() {
    let folder = folder();
    let [input, picture] = ["input.exr", "picture.png"].map(|name| folder.path().join(name));
    std::fs::write(&input, "kept").unwrap();
    let lost: &[&str] = &["input.exr is an input, which would be overwritten"];
    for option in ["--environment", "--reference"] {
        run("render", &[&BOX, &option, &input, &"-o", &input]).assert_refused(2, lost);
        run("render", &[&BOX, &option, &input, &"-o", &picture, &"--stats", &input]).assert_refused(2, lost);
    }
    let scene = folder.path().join("scene.gltf");
    let text = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4,"uri":"input.exr"}]}"#;
    std::fs::write(&scene, text).unwrap();
    run("render", &[&scene, &"-o", &input]).assert_refused(2, lost);
    run("merge", &[&input, &"-o", &input]).assert_refused(2, lost);
    run("merge", &[&input, &"-o", &picture, &"-o", &picture]).assert_refused(2, &["picture.png is named twice"]);
    let cases = folder.path().join("CASES.toml");
    let text = format!("baselines = \".\"\n[[case]]\nname = \"input\"\nscene = \"{BOX}\"\n");
    std::fs::write(&cases, &text).unwrap();
    for option in ["--html", "--junit"] {
        for (file, word) in [(&cases, "CASES.toml"), (&input, "input.exr"), (&std::path::PathBuf::from(BOX), "box.glb")]
        {
            run("check", &[&cases, &option, file]).assert_refused(2, &[word, "would be overwritten"]);
        }
    }
    assert_eq!(std::fs::read_to_string(&input).unwrap(), "kept");
    assert_eq!(std::fs::read_to_string(&cases).unwrap(), text);
}

#[test]
fn an_unknown_camera_is_wrong_usage() {
    run("plan --camera nobody", &[&BOX]).assert_refused(2, &["nobody", "camera"]);
    run("plan --camera 1", &[&BOX]).assert_refused(2, &["1", "camera"]);
}

/// Hides all drivers from the loader by its two variables; old loaders know only the second.
fn without_driver(arguments: &str, files: &[&dyn AsRef<OsStr>]) -> Answer {
    let nothing = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].map(|name| (name, "/nonexistent"));
    Answer::of(penumbra(arguments, files).envs(nothing))
}

#[test]
fn no_device_names_the_fix() {
    without_driver("devices", &[]).assert_refused(4, &["scripts/with-vulkan"]);
    let folder = folder();
    let output = folder.path().join("x.png");
    without_driver("render -o", &[&output, &BOX]).assert_refused(4, &["scripts/with-vulkan"]);
    assert!(!output.exists());
    // The error of a bad file comes before that of the device.
    without_driver("render -o", &[&output, &"no-scene.glb"]).assert_refused(3, &["no-scene.glb"]);
    without_driver("plan", &[&BOX]).assert_done();
}

#[test]
fn an_unknown_device_names_those_there_are() {
    let folder = folder();
    let known = run("devices --json", &[]).json()[0]["name"].as_str().unwrap().to_owned();
    let answer = run("render --device no-such-device -o", &[&folder.path().join("x.png"), &BOX]);
    answer.assert_refused(4, &["no-such-device", &known]);
}

/// The arguments of the commands that stand on lines of their own in a document's blocks of code: without comments, and
/// with the lines on which a backslash continues them.
fn commands(text: &str) -> Vec<String> {
    let mut commands = Vec::new();
    let joined = text.replace("\\\n", " ");
    for line in joined.lines().filter(|line| line.starts_with("    ")) {
        let line = line.split('#').next().unwrap_or_default().trim();
        let prefixes = ["penumbra ", "scripts/with-vulkan cargo run --release -- "];
        // Brackets and dots stand for what the reader adds.
        let arguments =
            prefixes.iter().find_map(|prefix| line.strip_prefix(prefix)).filter(|line| !line.contains("..."));
        commands.extend(arguments.map(str::to_owned));
    }
    commands
}

/// The program understands each command of the documents. `--help` at its end answers instead of a render, after the
/// arguments before it are read.
#[test]
fn documented_commands_are_understood() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let in_folder = |folder: &str| std::fs::read_dir(root.join(folder)).unwrap().map(|entry| entry.unwrap().path());
    let documents = in_folder("").chain(in_folder("docs")).chain(in_folder("scenes"));
    let documents = documents.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let mut count = 0;
    for document in documents {
        for command in commands(&std::fs::read_to_string(&document).unwrap()) {
            let answer = run(&format!("{command} --help"), &[]);
            assert!(answer.code == Some(0), "{}: {command}: {answer:?}", document.display());
            count += 1;
        }
    }
    assert!(count > 40, "{count} commands are too few: they are not found");
    // Two commands on one line, and an option that there is not.
    for wrong in ["render a.glb -o a.png penumbra render b.glb -o b.png", "render a.glb -o a.png --planted"] {
        assert_eq!(run(&format!("{wrong} --help"), &[]).code, Some(2), "{wrong}");
    }
}
