//! Full disks and vanishing folders.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use penumbra::Image;

use crate::program::{Answer, BOX, device, folder, penumbra, run, signal};

/// Fast settings: few photons, a small image.
pub const SMALL: &str = "--width 24 --height 16 --photons 4096 --max-bounces 0";

/// The sorted names of the files in a folder.
pub fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Starts a render of the box with an hour's time limit and waits until it takes samples. Returns the process, its
/// messages so far, and the stream of further ones.
pub fn begin(arguments: &str, outputs: &[&Path]) -> (Child, String, BufReader<std::process::ChildStderr>) {
    let mut command = penumbra(&format!("render --device {} --time 3600 {arguments}", device()), &[&BOX]);
    for output in outputs {
        command.arg("-o").arg(output);
    }
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut said = String::new();
    while !said.contains("rendering") {
        assert!(stderr.read_line(&mut said).unwrap() > 0, "it ended before it began: {said}");
    }
    (child, said, stderr)
}

/// Interrupts a render and waits for its end.
fn end((mut child, mut said, mut stderr): (Child, String, BufReader<std::process::ChildStderr>)) -> Answer {
    signal(&child, "-INT");
    stderr.read_to_string(&mut said).unwrap();
    Answer { code: child.wait().unwrap().code(), stdout: String::new(), stderr: said }
}

/// If a disk fills up during a write, the old files stay, no partial file is left, and a one-line error names the file.
/// A limit on the file size of two blocks acts as the full disk.
#[test]
fn a_disk_that_fills_up_keeps_the_old_files() {
    let folder = folder();
    let image = folder.path().join("a.exr");
    fs::write(&image, "old").unwrap();
    for other in ["--checkpoint", "--stats"] {
        let kept = folder.path().join(format!("kept{other}"));
        let arguments = format!("--quiet --spp 1 --aov all --device {} {SMALL}", device());
        let mut old = b"old".to_vec();
        if other == "--checkpoint" {
            // One of the same render, which is continued.
            let command = format!("render {arguments} --checkpoint {}", kept.display());
            run(&command, &[&"-o", &folder.path().join("first.exr"), &BOX]).assert_done();
            fs::remove_file(folder.path().join("first.exr")).unwrap();
            old = fs::read(&kept).unwrap();
        } else {
            fs::write(&kept, &old).unwrap();
        }
        let mut command = Command::new("sh");
        command.args(["-c", "trap '' XFSZ; ulimit -f 2; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_penumbra"), "render"]);
        command.args(arguments.split_whitespace()).args((other == "--checkpoint").then_some("--resume"));
        command.args([other, kept.to_str().unwrap(), "-o", image.to_str().unwrap(), BOX]);
        command.env("XDG_RUNTIME_DIR", env!("CARGO_TARGET_TMPDIR"));
        // The limit would affect Mesa's shader cache, too.
        command.env("MESA_SHADER_CACHE_DISABLE", "true");
        // The error names all files that are lost; the checkpoint is still the previous one.
        let also = format!("kept{other} is not written either");
        Answer::of(&mut command).assert_refused(3, &["a.exr", "cannot write", &also]);
        for (file, old) in [(&image, b"old".as_slice()), (&kept, &old)] {
            assert!(fs::read(file).unwrap() == old, "{}", file.display());
        }
    }
    assert_eq!(names(folder.path()), ["a.exr", "kept--checkpoint", "kept--stats"]);
}

/// On a full file system, files that fit are written and the image is saved to the temporary folder. Left out if no
/// file system can be mounted.
#[test]
fn an_image_that_does_not_fit_is_saved_elsewhere() {
    let folder = folder();
    let [disk, kept] = ["disk", "kept"].map(|name| folder.path().join(name));
    fs::create_dir(&disk).unwrap();
    fs::create_dir(&kept).unwrap();
    // The mount is in its own namespace and ends with the process. One page is free: enough for the .png only.
    let script = "mount -t tmpfs -o size=64k none \"$1\" || exit 77; head -c 60000 /dev/zero > \"$1/rest\"
        shift; \"$@\"; code=$?; ls -A \"$DISK\" > \"$TMPDIR/list\"; exit $code";
    let mut command = Command::new("unshare");
    command.args(["-rm", "sh", "-c", script, "sh"]).arg(&disk).arg(env!("CARGO_BIN_EXE_penumbra"));
    command.args(format!("render --quiet --spp 1 --aov all --device {} {SMALL}", device()).split_whitespace());
    command.args(["-o", disk.join("a.exr").to_str().unwrap(), "-o", disk.join("b.png").to_str().unwrap(), BOX]);
    command.env("XDG_RUNTIME_DIR", env!("CARGO_TARGET_TMPDIR")).env("TMPDIR", &kept).env("DISK", &disk);
    let answer = match command.output() {
        Ok(output) if output.status.code() != Some(77) && output.status.code() != Some(1) => Answer::from(output),
        _ => {
            println!("left out: a full file system, as none can be mounted here");
            return;
        }
    };
    answer.assert_refused(3, &["a.exr", "No space left", kept.to_str().unwrap()]);
    assert_eq!(fs::read_to_string(kept.join("list")).unwrap(), "b.png\nrest\n");
    // In a folder of its own.
    let folders: Vec<_> = names(&kept).into_iter().filter(|name| name != "list").collect();
    assert_eq!(folders.len(), 1, "{folders:?}");
    let rescued = kept.join(&folders[0]);
    assert_eq!(names(&rescued), ["rescued.exr"]);
    let image = Image::read(rescued.join("rescued.exr")).unwrap();
    assert_eq!((image.width, image.height), (24, 16));
}

/// An output folder that vanishes during the render is created again. If a file has taken its place, the image is saved
/// elsewhere and the error says where.
#[test]
fn an_output_folder_may_vanish() {
    let folder = folder();
    let outputs = folder.path().join("outputs");
    let [image, stats] = ["a.exr", "a.json"].map(|name| outputs.join(name));
    let arguments = format!("{SMALL} --stats {} --checkpoint {}", stats.display(), outputs.join("state").display());

    fs::create_dir(&outputs).unwrap();
    let render = begin(&arguments, &[&image]);
    fs::remove_dir_all(&outputs).unwrap();
    let answer = end(render);
    assert_eq!(answer.code, Some(130), "{answer:?}");
    assert_eq!(names(&outputs), ["a.exr", "a.json", "state"]);
    Image::read(&image).unwrap();

    fs::remove_file(outputs.join("state")).unwrap();
    let render = begin(&arguments, &[&image]);
    fs::remove_dir_all(&outputs).unwrap();
    fs::write(&outputs, "a file").unwrap();
    let answer = end(render);
    assert_eq!(answer.code, Some(3), "{answer:?}");
    let error = answer.stderr.lines().last().unwrap();
    let (problem, rest) = error.split_once("; the image is in ").unwrap_or_else(|| panic!("{answer:?}"));
    let (kept, others) = rest.split_once("; ").unwrap_or_else(|| panic!("{answer:?}"));
    assert!(others.contains("a.json is not written either") && others.ends_with("state is not written either"));
    assert!(problem.contains(image.to_str().unwrap()), "{answer:?}");
    assert!(Image::read(kept).is_ok(), "{answer:?}");
    fs::remove_dir_all(Path::new(kept).parent().unwrap()).unwrap();
    assert_eq!(fs::read_to_string(&outputs).unwrap(), "a file");
}

/// A file that cannot be written does not prevent the others from being written.
#[test]
fn one_failed_file_does_not_affect_the_others() {
    let folder = folder();
    let [lost, kept, state] = ["lost/a.exr", "b.exr", "lost/state"].map(|name| folder.path().join(name));
    fs::create_dir(folder.path().join("lost")).unwrap();
    let render = begin(&format!("{SMALL} --checkpoint {}", state.display()), &[&lost, &kept]);
    fs::remove_dir_all(folder.path().join("lost")).unwrap();
    fs::write(folder.path().join("lost"), "").unwrap();
    let answer = end(render);
    assert_eq!(answer.code, Some(3), "{answer:?}");
    Image::read(&kept).unwrap();
    let (_, rescued) = answer.stderr.trim_end().rsplit_once("; the image is in ").unwrap();
    let (rescued, others) = rescued.split_once("; ").unwrap();
    assert!(others.ends_with("lost/state is not written either"), "{answer:?}");
    fs::remove_dir_all(Path::new(rescued).parent().unwrap()).unwrap();
}
