//! Real windows, with synthetic input, against images that `render` writes.

use std::cell::RefCell;
use std::fs;
use std::path::Path;
use std::process::Command;

use crate::setup::{BOX, SPHERE, folder};
use crate::xvfb::{Display, Screenshot, program};

/// Size of the picture.
const SIZE: [usize; 2] = [160, 120];

/// Options of picture and reference. Denoising is tested in sessions of `render`.
const OPTIONS: &str = "--width 160 --height 120 --spp 4 --denoise none --device software";

fn rendered(file: &str, folder: &Path) -> Screenshot {
    let output = folder.join("reference.png");
    let mut command = program();
    command.arg("render").arg(file).args(OPTIONS.split(' ')).arg("-o").arg(&output).arg("--quiet");
    assert!(command.status().unwrap().success());
    Screenshot::read(&output)
}

/// The picture in a window that has its size: the panel is on its right.
fn picture(screen: &Screenshot) -> Screenshot {
    screen.part([0, 0], SIZE)
}

#[test]
fn without_a_display_the_error_names_render() {
    let output = program().args(["view", BOX]).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(4), "{message}");
    assert!(message.starts_with("penumbra: error: no display: "), "{message}");
    assert!(message.contains("penumbra render") && message.lines().count() == 1, "{message}");
}

#[test]
fn a_bad_scene_opens_no_window() {
    let display = Display::start();
    for (arguments, code) in [("view missing.glb", 3), ("view --crop=0,0,2,2 scenes/box.glb", 2)] {
        let mut command = program();
        let status = command.env("DISPLAY", display.name()).args(arguments.split(' ')).output().unwrap().status;
        assert_eq!(status.code(), Some(code), "{arguments}");
    }
}

/// While the driver compiles kernels that it has never seen, the window shows its progress and keeps drawing.
#[test]
fn a_window_tells_of_compilation() {
    // A cache of its own, and empty.
    let cache = folder();
    let display = Display::start();
    let cold = [("MESA_SHADER_CACHE_DIR", cache.path())];
    let mut program = display.run_with(&format!("view {BOX} {OPTIONS}"), &cold);
    let text = |screen: &Screenshot| screen.part([SIZE[0], SIZE[1] / 2 - 10], [100, 20]);
    // A room has no wall of a single colour.
    let corner = |screen: &Screenshot, x| screen.part([x, 0], [20, 20]);
    let seen: RefCell<Vec<Screenshot>> = RefCell::default();
    program.wait("a picture", |screen| {
        let is_there = corner(screen, 0) != corner(screen, 20);
        if !is_there && !seen.borrow().contains(&text(screen)) {
            seen.borrow_mut().push(text(screen));
        }
        is_there
    });
    // An empty screen, an empty window, the text before the first kernel, and numbers.
    let seen = seen.into_inner();
    assert!(seen.len() > 5, "{} different texts", seen.len());
    display.focus();
    assert_eq!(program.quit(), Some(0));
}

/// One session: the picture of `render`, movements, the copied command, overlays, a file that changes, sizes.
#[test]
fn a_session_shows_what_render_writes() {
    let folder = folder();
    let scene = folder.path().join("scene.glb");
    fs::copy(BOX, &scene).unwrap();
    let first = rendered(BOX, folder.path());
    let display = Display::start();
    let mut program = display.run(&format!("view {} {OPTIONS}", scene.display()));
    let is_first = |screen: &Screenshot| picture(screen) == first;
    program.wait("the picture of render", is_first);
    display.focus();

    // Movements: the copied command renders the picture to the bit.
    // By less than 30 degrees: farther on, a wall is in front of the camera.
    display.input("mousemove 80 60 mousedown 1 sleep 0.2 mousemove_relative 8 2 sleep 0.2 mousemove_relative 8 2");
    display.input("mouseup 1 click 4");
    let command = program.copied(|command| command.contains(" --look-from="));
    assert!(command.contains(" --look-at=") && command.contains(" --fov="), "{command}");
    let moved = run_copied(&command, folder.path());
    assert!(moved != first && moved.mean() > 20.0, "the camera does not see the room");
    let is_moved = |screen: &Screenshot| picture(screen) == moved;
    let screen = program.wait("the picture of the copied command", is_moved);

    // Overlays, by their keys; 1 is the picture again.
    for overlay in ["2", "3", "4", "7", "8", "9"] {
        display.input(&format!("key {overlay}"));
        program.wait(overlay, |screen| picture(screen) != moved);
    }
    display.input("key 1");
    program.wait("the picture after the overlays", is_moved);

    // A broken file keeps the picture, and the panel shows a message.
    fs::write(&scene, "broken").unwrap();
    let panel = |screen: &Screenshot| screen.part([SIZE[0], 0], [200, SIZE[1]]);
    let broken = program.wait("the message", |now| panel(now) != panel(&screen));
    assert!(is_moved(&broken));
    // A right one is shown from the same view.
    fs::copy(SPHERE, &scene).unwrap();
    program.wait("the other scene", |screen| !is_moved(screen));
    fs::copy(BOX, &scene).unwrap();
    program.wait("the first scene again", is_moved);

    // Sizes: next to nothing, and more.
    display.resize([1, 1]);
    program.wait_for_rest();
    display.resize([SIZE[0] + 270 + 40, SIZE[1] + 60]);
    program.wait("the centre of a larger window", |screen| screen.part([20, 30], SIZE) == moved);
    assert_eq!(program.quit(), Some(0));
}

/// Runs a copied command with a shell, and returns the picture that it writes.
fn run_copied(command: &str, folder: &Path) -> Screenshot {
    let rest = command.strip_prefix("penumbra ").unwrap();
    let line = format!("{} {rest} --quiet", env!("CARGO_BIN_EXE_penumbra"));
    let status = Command::new("sh").arg("-c").arg(line).current_dir(folder).status().unwrap();
    assert!(status.success(), "{command}");
    Screenshot::read(&folder.join("picture.png"))
}

/// A window that is resized while the worker submits samples goes on: wgpu refuses to configure a surface while another
/// thread submits, and the device would be faulty from then on.
#[test]
fn a_window_is_resized_while_it_renders() {
    let display = Display::start();
    let options = "--width 320 --height 240 --spp 100000 --denoise none --device software";
    let mut program = display.run(&format!("view {BOX} {options}"));
    display.focus();
    let corner = |screen: &Screenshot, x| screen.part([x, 0], [20, 20]);
    program.wait("a picture", |screen| corner(screen, 0) != corner(screen, 20));
    for i in 0..10 {
        display.resize([700 + 10 * i, 400 - 8 * i]);
        display.input("sleep 0.1");
    }
    // The panel counts samples.
    let panel = |screen: &Screenshot| screen.part([800 - 270, 0], [260, 240]);
    let mut last = display.screenshot();
    for _ in 0..5 {
        display.input("sleep 1");
        last = program.wait("more samples", |screen| panel(screen) != panel(&last));
    }
    assert_eq!(program.quit(), Some(0));
}

/// A picture without a size of its own has that of the window.
#[test]
fn a_picture_follows_its_window() {
    let display = Display::start();
    let mut program = display.run(&format!("view {BOX} --spp 1 --denoise none --device software"));
    display.focus();
    display.resize([390, 120]);
    let is_lit = |screen: &Screenshot| screen.part([10, 50], [100, 20]).mean() > 20.0;
    program.wait("a picture", is_lit);
    program.copied(|command| command.contains(" --width=120 --height=120 "));
    assert_eq!(program.quit(), Some(0));
}
