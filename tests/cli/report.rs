//! `penumbra report`: its files, and the reference that it makes, keeps and continues.

use std::fs;
use std::path::Path;

use penumbra::Image;
#[cfg(unix)]
use penumbra::internal::render::film::Metadata;
use serde_json::Value;

use crate::program::{Answer, BOX, device, folder, oidn_library, run};
#[cfg(unix)]
use crate::program::{penumbra, signal};
use crate::schema;

/// Quick settings: few photons, a small image.
const SMALL: &str = "--width 24 --height 16 --photons 4096";

/// Reports on the box in `folder`, with the cache beside.
fn report(folder: &Path, arguments: &str) -> Answer {
    let arguments = format!("report --device {} {SMALL} --repeats 3 {arguments}", device());
    run(&arguments, &[&BOX, &"--cache", &folder.join("cache"), &"-o", &folder.join("report")])
}

fn read_json(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("report/report.json")).unwrap()).unwrap()
}

#[test]
fn everything_is_written_and_as_documented() {
    let folder = folder();
    let folder = folder.path();
    // A sweep renders nine times for each value: direct light alone is quick.
    let arguments = "--techniques shadow-photons,path --budgets 1.5,0.5 --reference-error 0.1 --sweep nearest=10..20 \
                     --max-bounces 0";
    let answer = report(folder, arguments);
    answer.assert_done();
    assert!(answer.stdout.is_empty() && answer.stderr.contains("reference: "), "{answer:?}");
    let json = read_json(folder);
    schema::assert_documented("Report", &json);
    assert!(json["reference"]["standard_error"].as_f64().unwrap() <= 0.1);
    assert_eq!(json["comparisons"], serde_json::json!([]), "two-pass is not there");
    assert_eq!(json["classes"][0]["technique"], "shadow-photons");
    let class = &json["classes"][0];
    let points: u64 = ["lit", "shadowed", "boundary", "unknown"]
        .iter()
        .flat_map(|name| ["hidden", "penumbra", "visible"].map(|truth| class[name][truth].as_u64().unwrap()))
        .sum();
    assert_eq!(class["points"].as_u64().unwrap(), points);

    let swept = json["sweeps"][0]["points"].as_array().unwrap();
    let values: Vec<u64> = swept.iter().map(|point| point["value"].as_u64().unwrap()).collect();
    // Equal ratios: the sixth root of 2, rounded.
    assert_eq!(values, [10, 11, 13, 14, 16, 18, 20]);

    let csv = fs::read_to_string(folder.join("report/report.csv")).unwrap();
    let columns = csv.lines().next().unwrap().split(',').count();
    assert!(csv.lines().all(|line| line.split(',').count() == columns), "{csv}");
    let seeds = |technique: &str| {
        let lines = csv.lines().filter(|line| line.starts_with(technique));
        lines.map(|line| line.split(',').nth(1).unwrap()).collect::<std::collections::BTreeSet<_>>().len()
    };
    assert_eq!((seeds("path,"), seeds("two-pass,")), (3, 0));
    for plot in ["error", "rays", "passes", "sweep-nearest", "savings-nearest"] {
        let svg = fs::read_to_string(folder.join(format!("report/{plot}.svg"))).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{svg}");
    }
    let page = fs::read_to_string(folder.join("report/report.html")).unwrap();
    // The namespace of SVG is a name; it is not fetched.
    assert!(!page.replace("http://www.w3.org/2000/svg", "").contains("://"), "the page needs a network");
    assert!(!page.contains("{{"), "a part of the page is missing");

    // The reference that was made can be given to another report, with its own error.
    let given = folder.join("report/reference.exr");
    let kept = folder.join("given.exr");
    fs::copy(&given, &kept).unwrap();
    let arguments = format!("--quiet --techniques path --budgets 1 --reference {}", kept.display());
    let answer = report(folder, &arguments);
    assert_eq!(answer.assert_done().stderr, "");
    let mut expected = json["reference"].clone();
    assert_eq!(expected["goal"].take(), 0.1, "only one that is made has a goal");
    assert_eq!(read_json(folder)["reference"], expected);
}

/// A file that cannot be written does not stop the others, and each is named. The measurements are saved elsewhere.
#[cfg(unix)]
#[test]
fn what_can_be_written_is_written() {
    use std::io::{BufRead, BufReader, Read};

    let folder = folder();
    let [reports, temporary] = ["report", "temporary"].map(|name| folder.path().join(name));
    fs::create_dir(&temporary).unwrap();
    let lost = ["report.json", "error.svg"].map(|name| reports.join(name));
    let arguments = format!(
        "report --device {} {SMALL} --repeats 3 --techniques path --budgets 1 --reference-error 0.5 --max-bounces 0",
        device()
    );
    for has_room in [true, false] {
        let mut command = penumbra(&arguments, &[&BOX, &"--cache", &folder.path().join("cache"), &"-o", &reports]);
        let gone = folder.path().join("gone");
        command.env("TMPDIR", if has_room { &temporary } else { &gone });
        command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (mut stderr, mut said) = (BufReader::new(child.stderr.take().unwrap()), String::new());
        while !said.contains("run 1 of 3") {
            assert!(stderr.read_line(&mut said).unwrap() > 0, "it ended before its runs: {said}");
        }
        lost.iter().for_each(|file| fs::create_dir(file).unwrap());
        stderr.read_to_string(&mut said).unwrap();
        let answer = Answer { stderr: said, ..Answer::from(child.wait_with_output().unwrap()) };
        assert_eq!(answer.code, Some(3), "{answer:?}");
        let error = answer.stderr.lines().last().unwrap();
        assert!(error.contains("report.json: cannot write") && error.contains("error.svg is not written"), "{error}");
        for name in ["report.csv", "report.html", "rays.svg", "passes.svg", "reference.exr"] {
            assert!(reports.join(name).is_file(), "{name}");
        }
        let measurements = match has_room {
            true => fs::read_to_string(error.rsplit_once("measurements are in ").unwrap().1).unwrap(),
            false => answer.stdout.clone(),
        };
        assert_eq!(serde_json::from_str::<Value>(&measurements).unwrap()["runs"], 3, "{error}");
        lost.iter().for_each(|file| fs::remove_dir(file).unwrap());
    }
}

/// Techniques with denoisers are entrants of their own, each once and in the order of techniques.
#[test]
fn denoisers_make_entrants() {
    let folder = folder();
    let folder = folder.path();
    let library = oidn_library();
    // Without a second bounce the reference takes little time.
    let arguments = format!(
        "--techniques path+auto,path+oidn,path,path+statistical,path+oidn --budgets 1,2 --reference-error 0.2 \
         --max-bounces 1 --oidn {}",
        library.display()
    );
    let answer = report(folder, &arguments);
    answer.assert_done();
    let json = read_json(folder);
    schema::assert_documented("Report", &json);
    assert_eq!(json["schema"], 4);
    let expected = [
        ("path", "none", serde_json::json!([])),
        ("path+auto", "auto", serde_json::json!(["oidn", "statistical"])),
        ("path+statistical", "statistical", serde_json::json!(["statistical"])),
        ("path+oidn", "oidn", serde_json::json!(["oidn"])),
    ];
    let entrants = json["entrants"].as_array().unwrap();
    assert_eq!(entrants.len(), expected.len());
    let csv = fs::read_to_string(folder.join("report/report.csv")).unwrap();
    for (entrant, (name, denoise, denoisers)) in entrants.iter().zip(&expected) {
        assert_eq!(entrant["entrant"], *name);
        assert!((1..=3).all(|run| answer.stderr.contains(&format!("{name}, run {run} of 3: "))), "{answer:?}");
        assert_eq!(entrant["settings"]["denoise"], *denoise);
        assert_eq!(entrant["denoisers"], *denoisers);
        let is_denoised = *denoise != "none";
        assert_eq!(entrant["time"]["denoise"].as_f64().unwrap() > 0.0, is_denoised);
        let passes = entrant["time"]["passes"].as_object().unwrap();
        assert!(passes.keys().all(|pass| !pass.starts_with("denoise")), "{passes:?}");
        // Thousands of samples fit into the last budget.
        let last = entrant["snapshots"].as_array().unwrap().last().unwrap();
        assert_eq!(last["estimate"]["value"].is_number(), is_denoised, "{last}");
        // On a busy machine an image may be late for a budget, but hardly those of all runs.
        assert!((0..3).any(|seed| csv.contains(&format!("\n{name},{seed},2,"))), "{csv}");
    }
    let plot = fs::read_to_string(folder.join("report/error.svg")).unwrap();
    // The legend has a line for each, with the slope after a comma.
    let has = |name: &str| plot.lines().any(|line| line.split(',').next() == Some(name));
    assert!(expected.iter().all(|(name, ..)| has(name)), "{plot}");
}

/// `auto` is an entrant, and the command prints how it compares with the others.
#[test]
fn auto_is_compared_with_the_others() {
    let folder = folder();
    let folder = folder.path();
    let answer = report(folder, "--techniques auto,path --budgets 1,2 --reference-error 0.2 --max-bounces 0");
    assert!(answer.assert_done().stderr.contains("auto within 2 s: "), "{answer:?}");
    let json = read_json(folder);
    schema::assert_documented("Report", &json);
    let row = json["auto"].as_array().unwrap().last().unwrap();
    assert_eq!((&row["entrant"], &row["budget"], &row["best"]), (&"auto".into(), &2.0.into(), &"path".into()));
    assert_eq!(json["entrants"][1]["slope"], Value::Null);
}

/// A library that is not there is an error before anything is rendered, if an entrant needs it.
#[test]
fn entrants_without_their_library_are_refused() {
    let folder = folder();
    let folder = folder.path();
    for entrant in ["path+oidn", "two-pass+auto"] {
        let answer = report(folder, &format!("--techniques path,{entrant} --oidn none/missing.so"));
        answer.assert_refused(3, &["missing.so", "there is no such file", "--oidn or OIDN_LIBRARY"]);
        assert!(!folder.join("report").exists() && !folder.join("cache").exists());
    }
    let without = report(folder, "--quiet --techniques path --budgets 1e-9 --reference-error 0.5 --oidn missing.so");
    without.assert_refused(2, &["--budgets are too short"]);
}

/// An entrant that refuses a setting is named before the scene is read, among the techniques of the default list too.
#[test]
fn entrants_that_refuse_a_setting_are_refused_before_anything_is_rendered() {
    let folder = folder();
    let folder = folder.path();
    for (sampling, more, problem) in [
        ("all", "", "a path samples one light"),
        ("contribution", "", "a path does not weigh"),
        ("zones", "--techniques two-pass", "two-pass has no visibility photons"),
        ("power", "--techniques shadow-photons,visibility-cells", "visibility-cells uses all lights"),
        ("zones", "--techniques shadow-photons --sweep nearest=10..20", "two-pass has no visibility photons"),
    ] {
        let scene = if more.contains("--sweep") { Path::new(BOX) } else { Path::new("no-scene.glb") };
        let arguments = format!("report {SMALL} --light-sampling {sampling} {more} --cache");
        let answer = run(&arguments, &[&folder.join("cache"), &"-o", &folder.join("none"), &scene]);
        answer.assert_refused(2, &["--light-sampling", problem]);
        assert!(!folder.join("none").exists(), "{sampling}");
    }
}

#[test]
fn references_that_cannot_be_used_are_refused_before_anything_is_rendered() {
    let folder = folder();
    let folder = folder.path();
    let refuse = |image: &Image, words: &[&str]| {
        let file = folder.join("bad.exr");
        image.write_exr(&file).unwrap();
        let answer = report(folder, &format!("--reference {}", file.display()));
        answer.assert_refused(3, &[&["bad.exr"], words].concat());
    };
    let mut image = Image::new(24, 16);
    image.add_channel("R", vec![1.0; 24 * 16]);
    refuse(&image, &["G"]);
    image.add_channel("G", vec![1.0; 24 * 16]);
    image.add_channel("B", vec![f32::NAN; 24 * 16]);
    refuse(&image, &["B", "NaN"]);
    let mut small = Image::new(8, 8);
    for name in ["R", "G", "B"] {
        small.add_channel(name, vec![1.0; 64]);
    }
    refuse(&small, &["8 x 8", "24 x 16"]);
    for budgets in ["0,1", "x", "1,inf"] {
        let arguments = format!("--budgets {budgets}");
        report(folder, &arguments).assert_refused(2, &["--budgets", "a finite number, more than 0"]);
    }
    let twice = "--sweep photons=1e3..1e4 --sweep photons=1e4..1e6";
    report(folder, twice).assert_refused(2, &["--sweep", "two ranges of photons"]);
    report(folder, "--techniques shadow-photon").assert_refused(2, &["shadow-photon'", "shadow-photons"]);

    let file = folder.join("file");
    fs::write(&file, "").unwrap();
    run("report", &[&BOX, &"-o", &file]).assert_refused(3, &[file.to_str().unwrap()]);
    // A report that could not begin leaves nothing.
    let [scene, output] = ["none.glb", "none"].map(|name| folder.join(name));
    run("report", &[&scene, &"-o", &output]).assert_refused(3, &["none.glb"]);
    assert!(!output.exists() && !folder.join("report").exists());
    // Nor does one that could not be made; a folder of the user's own stays.
    for made in [false, true] {
        let none = report(folder, "--quiet --techniques path --budgets 1e-9 --reference-error 0.5");
        none.assert_refused(2, &["--budgets are too short"]);
        assert_eq!(folder.join("report").exists(), made);
        fs::create_dir_all(folder.join("report")).unwrap();
    }
}

/// Stops a report as soon as it has printed `words`; returns all that it printed.
#[cfg(unix)]
fn stopped(folder: &Path, arguments: &str, words: &str) -> String {
    use std::io::{BufRead, BufReader, Read};
    use std::process::Stdio;

    let arguments = format!("report --device {} {SMALL} {arguments}", device());
    let mut child = penumbra(&arguments, &[&BOX, &"--cache", &folder.join("cache"), &"-o", &folder.join("report")])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut said = String::new();
    while !said.contains(words) {
        assert!(stderr.read_line(&mut said).unwrap() > 0, "it ended before it began: {said}");
    }
    signal(&child, "-INT");
    stderr.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    said
}

#[cfg(unix)]
#[test]
fn a_signal_keeps_the_reference() {
    let folder = folder();
    let folder = folder.path();
    // A standard error that is never reached.
    stopped(folder, "--reference-error 1e-9 --repeats 3", "reference: ");
    let kept = fs::read_dir(folder.join("cache")).unwrap().next().unwrap().unwrap().path();
    let half = Image::read(kept.join("half-0.exr")).unwrap();
    assert_ne!(half.metadata["samplesPerPixel"], Metadata::Int(0));
    assert!(!folder.join("report/report.json").exists());
}

/// By default there are five runs of each technique, or as many as three minutes have time for, but at least three.
#[cfg(unix)]
#[test]
fn repeats_follow_the_time_there_is() {
    let folder = folder();
    let folder = folder.path();
    let said = |arguments: &str| stopped(folder, &format!("--reference-error 1e-9 {arguments}"), "runs of");
    let four = "--techniques path,two-pass,shadow-photons,photon-map --budgets 10";
    let fewer = said(four);
    assert!(fewer.contains("16 runs of 10 s: 2 min 40 s"), "{fewer}");
    assert!(fewer.contains("4 runs of each technique instead of 5") && fewer.contains("3 min 20 s"), "{fewer}");
    let short = said("--techniques path,two-pass --budgets 2");
    assert!(short.contains("10 runs of 2 s: 20 s") && !short.contains("instead of"), "{short}");
    let long = said("--budgets 30");
    // Three of each of the ten techniques.
    assert!(long.contains("30 runs of 30 s: 15 min 0 s"), "{long}");
    let asked = said(&format!("{four} --repeats 7"));
    assert!(asked.contains("28 runs of 10 s") && !asked.contains("instead of"), "{asked}");
}

/// Three runs of each technique make a report, however many were requested.
#[cfg(unix)]
#[test]
fn a_signal_keeps_the_runs_that_all_techniques_have() {
    let folder = folder();
    let folder = folder.path();
    let arguments = "--techniques path,photon-map --budgets 1 --reference-error 0.2 --repeats 90";
    let said = stopped(folder, arguments, "path, run 4 of 90");
    assert!(said.contains("180 runs of 1 s: 3 min 0 s"), "{said}");
    let json = read_json(folder);
    schema::assert_documented("Report", &json);
    // The fourth round may have been over by then.
    let runs = json["runs"].as_u64().unwrap();
    assert!((3..=4).contains(&runs) && said.contains(&format!("{runs} of 90 runs")), "{runs}: {said}");
    let csv = fs::read_to_string(folder.join("report/report.csv")).unwrap();
    let seeds = csv.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().parse::<u64>().unwrap());
    assert_eq!(seeds.max(), Some(runs - 1), "{csv}");
}

/// A script that uses the page as a person does, and writes what it saw into the page.
const VISITOR: &str = r#"<script>
const faults = [];
addEventListener("error", (event) => faults.push(event.message));
addEventListener("load", () => setTimeout(() => {
  const find = (id) => document.getElementById(id);
  const choose = (id, value) => { find(id).value = value; find(id).dispatchEvent(new Event("input")); };
  const press = (key, shiftKey = false) =>
    find("viewer").dispatchEvent(new KeyboardEvent("keydown", { key, shiftKey }));
  const middle = () => {
    const { width, height } = find("viewer");
    // A little off the corner where four pixels meet.
    return [...find("viewer").getContext("2d").getImageData(width / 2 + 4, height / 2 + 4, 1, 1).data].join(" ");
  };
  const seen = { tables: ["entrants", "snapshots", "confusion"].map((id) => find(id).rows.length), shown: {} };
  seen.pictures = [...find("denoised").querySelectorAll("figure")].map((figure) => figure.textContent);
  seen.different = new Set([...find("denoised").querySelectorAll("canvas")].map((canvas) => canvas.toDataURL())).size;
  choose("exposure", 0);
  choose("left", 1);
  choose("right", 0);
  choose("wiper", 1);
  seen.shown.left = middle();
  choose("wiper", 0);
  seen.shown.right = middle();
  choose("exposure", -3);
  seen.shown.darker = middle();
  choose("mode", "error");
  seen.shown.error = middle();
  press("]");
  press("]");
  seen.wiper = find("wiper").value;
  press("ArrowDown", true);
  seen.readout = find("readout").textContent;
  choose("layout", "pair");
  press("+");
  document.body.innerHTML = "";
  const outcome = document.createElement("pre");
  outcome.id = "outcome";
  outcome.textContent = JSON.stringify({ ...seen, faults });
  document.body.append(outcome);
}, 500));
</script>"#;

#[test]
fn the_page_works_in_a_browser() {
    let Some(browser) = ["chromium", "chromium-browser", "google-chrome"].into_iter().find(|name| {
        std::process::Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success())
    }) else {
        println!("left out: the page in a browser, as there is no Chromium");
        return;
    };
    let folder = folder();
    let folder = folder.path();
    let techniques = "--techniques shadow-photons,path+statistical";
    report(folder, &format!("--quiet {techniques} --budgets 3,6 --reference-error 0.2")).assert_done();
    let page = fs::read_to_string(folder.join("report/report.html")).unwrap();
    let visited = folder.join("visited.html");
    fs::write(&visited, page.replace("</body>", &format!("{VISITOR}</body>"))).unwrap();
    let output = std::process::Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=10000", "--dump-dom"])
        .arg(format!("--user-data-dir={}", folder.join("profile").display()))
        .arg(format!("file://{}", visited.display()))
        .output()
        .unwrap();
    let document = String::from_utf8(output.stdout).unwrap();
    let outcome = document.split_once("<pre id=\"outcome\">").and_then(|(_, rest)| rest.split_once("</pre>"));
    let Some((outcome, _)) = outcome else { panic!("the page is not done: {document:.2000}") };
    let seen: Value = serde_json::from_str(outcome).unwrap();
    assert_eq!(seen["faults"], serde_json::json!([]));
    let json = read_json(folder);
    let entrants = json["entrants"].as_array().unwrap();
    let images: usize = entrants.iter().map(|entrant| entrant["snapshots"].as_array().unwrap().len()).sum();
    // Each with a header row; one row for each class.
    assert_eq!(seen["tables"], serde_json::json!([1 + entrants.len(), 1 + images, 5]));
    let pictures = ["raw", "denoised", "difference", "estimated error", "error"];
    assert_eq!(seen["pictures"], serde_json::json!(pictures));
    // A fast machine renders enough samples that raw and denoised pixels show the same colours.
    let different = seen["different"].as_u64().unwrap() as usize;
    assert!(different + 1 >= pictures.len(), "{different} different pictures");

    // Display values of the middle pixel, computed from the files.
    let image = Image::read(folder.join("report/reference.exr")).unwrap();
    let middle = |gain: f32| {
        let code = |name: &str| {
            let x = gain * image.channel(name).unwrap()[8 * 24 + 12];
            let coded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
            (255.0 * coded.clamp(0.0, 1.0)).round() as i32
        };
        ["R", "G", "B"].map(code)
    };
    let shown = |name: &str| -> Vec<i32> {
        seen["shown"][name].as_str().unwrap().split(' ').map(|code| code.parse().unwrap()).collect()
    };
    for (name, gain) in [("right", 1.0), ("darker", 0.125)] {
        // Half floats have 11 bits: one display value more or less.
        let near = shown(name).iter().zip(middle(gain)).all(|(found, expected)| (found - expected).abs() <= 1);
        assert!(near, "{name}: {:?}, not {:?}", shown(name), middle(gain));
    }
    assert_ne!(shown("left"), shown("right"));
    assert_eq!(shown("error")[..3], [0, 0, 0], "the reference is no way from itself");
    assert_eq!(seen["wiper"], "0.1");
    let readout = seen["readout"].as_str().unwrap();
    assert!(readout.starts_with("pixel 12, 9") && readout.contains("reference: "), "{readout}");
}
