//! The panel without a display: what it shows, as a screen reader hears it, and what input makes of it.

use std::path::PathBuf;
use std::sync::Arc;

use egui::{Event, Key, Modifiers, PointerButton, Pos2, RawInput, Rect, Vec2, accesskit};
use kernel_kit::Compilation;
use penumbra::internal::view::{Command, Eye, Overlay, Panel, Picture, Pose, Request, Snapshot};

use crate::setup::{choices, settings};

const WINDOW: Vec2 = Vec2::new(800.0, 1000.0);

/// The centre of the picture: the panel is on the right.
const PICTURE: Pos2 = Pos2::new(265.0, 500.0);

fn snapshot() -> Snapshot {
    Snapshot {
        pixels: Arc::new(vec![100; 48 * 36 * 3]),
        size: [48, 36],
        samples: 2,
        is_complete: false,
        seconds: 0.05,
        picture: Picture {
            file: PathBuf::from("folder/scene.glb"),
            eye: Eye::default(),
            choices: choices(settings().with(|s| (s.image.width, s.image.height) = (480, 360))),
        },
        fov: Some(40.0),
        cameras: vec!["door".into(), "window".into()],
        lights: vec!["lamp".into(), "sun".into()],
        variants: vec!["oak".into()],
        animation_end: Some(2.0),
        has_panorama: false,
        message: Some("a message".into()),
        picked: None,
    }
}

/// A window with the panel.
struct Window {
    context: egui::Context,
    panel: Panel,
    snapshot: Snapshot,
    seconds: f64,
}

impl Window {
    fn new(snapshot: Snapshot) -> Window {
        let context = egui::Context::default();
        context.enable_accesskit();
        let mut window = Window { context, panel: Panel::new(false), snapshot, seconds: 0.0 };
        // Widgets know their places after the first layout.
        window.frame(Vec::new(), Modifiers::NONE);
        window
    }

    /// Lays out the window once. Returns what the user wants, and the nodes of the accessibility tree.
    fn frame(&mut self, events: Vec<Event>, modifiers: Modifiers) -> (Vec<Request>, Vec<accesskit::Node>) {
        self.seconds += 0.02;
        let screen_rect = Some(Rect::from_min_size(Pos2::ZERO, WINDOW));
        let time = Some(self.seconds);
        let events = [vec![Event::ModifiersChanged(modifiers)], events].concat();
        let input = RawInput { events, screen_rect, time, focused: true, ..RawInput::default() };
        let mut requests = Vec::new();
        let mut output = self.context.run_ui(input, |ui| requests.extend(self.panel.show(ui, &self.snapshot)));
        output.textures_delta.clear();
        let nodes = output.platform_output.accesskit_update.map(|update| update.nodes).unwrap_or_default();
        (requests, nodes.into_iter().map(|(_, node)| node).collect())
    }

    fn commands(&mut self, events: Vec<Event>, modifiers: Modifiers) -> Vec<String> {
        let (requests, _) = self.frame(events, modifiers);
        requests.iter().map(|request| format!("{request:?}")).collect()
    }

    /// The texts that a screen reader hears.
    fn texts(&mut self) -> Vec<String> {
        let (_, nodes) = self.frame(Vec::new(), Modifiers::NONE);
        nodes.iter().flat_map(|node| [node.label(), node.value()]).flatten().map(str::to_owned).collect()
    }

    /// The centre of the widget with that label, or the list with that entry selected.
    fn find(&mut self, text: &str) -> Pos2 {
        let (_, nodes) = self.frame(Vec::new(), Modifiers::NONE);
        let is_found = |node: &&accesskit::Node| node.label() == Some(text) || node.value() == Some(text);
        let node = nodes.iter().find(is_found).unwrap_or_else(|| panic!("no {text}"));
        let bounds = node.bounds().unwrap();
        Pos2::new((bounds.x0 + bounds.x1) as f32 / 2.0, (bounds.y0 + bounds.y1) as f32 / 2.0)
    }

    fn drag(&mut self, button: PointerButton, by: Vec2, modifiers: Modifiers) -> Vec<String> {
        self.frame(vec![Event::PointerMoved(PICTURE)], modifiers);
        self.frame(vec![press(PICTURE, button, true, modifiers)], modifiers);
        let commands = self.commands(vec![Event::PointerMoved(PICTURE + by)], modifiers);
        self.frame(vec![press(PICTURE + by, button, false, modifiers)], modifiers);
        commands
    }

    fn click(&mut self, at: Pos2) -> Vec<String> {
        let button = PointerButton::Primary;
        self.frame(vec![Event::PointerMoved(at)], Modifiers::NONE);
        self.frame(vec![press(at, button, true, Modifiers::NONE)], Modifiers::NONE);
        self.commands(vec![press(at, button, false, Modifiers::NONE)], Modifiers::NONE)
    }
}

fn press(pos: Pos2, button: PointerButton, pressed: bool, modifiers: Modifiers) -> Event {
    Event::PointerButton { pos, button, pressed, modifiers }
}

fn key(key: Key, modifiers: Modifiers) -> Event {
    Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers }
}

#[test]
fn the_panel_has_its_labels() {
    let mut snapshot = snapshot();
    snapshot.picture.choices.display.overlay = Overlay::Classes;
    let texts = Window::new(snapshot).texts();
    for text in [
        "the picture",
        "scene.glb",
        "480 x 360 pixels",
        "2 of 4 samples, rendering",
        "a message",
        "camera",
        "field of view",
        "depth of field",
        "frame all",
        "show",
        "light",
        "exposure",
        "tone mapping",
        "denoised",
        "technique",
        "samples",
        "light scale",
        "animation",
        "materials",
        "copy command",
        "save",
        "camera's name",
        "copy of the scene",
        "save camera",
        "replace",
    ] {
        assert!(texts.iter().any(|found| found == text), "{text:?} is not in {texts:#?}");
    }
    assert!(texts.iter().all(|found| found != "environment"), "without an environment");
}

/// Before the first picture and beside a picture, as the command line tells it.
#[test]
fn compilation_is_shown_until_it_is_done() {
    let said = "compiling 4 of 27 kernels".to_owned();
    let mut window = Window::new(snapshot());
    assert!(!window.texts().contains(&said));
    window.panel.compiling(Compilation { done: 4, all: 27 });
    assert!(window.texts().contains(&said));
    let wait = |panel: &Panel, input: RawInput| {
        let mut quits = false;
        let mut output = window.context.run_ui(input, |ui| quits |= panel.wait(ui));
        output.textures_delta.clear();
        let nodes = output.platform_output.accesskit_update.unwrap().nodes;
        let texts = nodes.iter().filter_map(|(_, node)| node.value().or(node.label()).map(str::to_owned));
        (texts.collect::<Vec<_>>(), quits)
    };
    let waiting = |panel: &Panel| wait(panel, RawInput::default()).0;
    let mut panel = Panel::new(false);
    assert!(waiting(&panel).contains(&"preparing the scene".to_owned()));
    panel.compiling(Compilation { done: 4, all: 27 });
    assert!(waiting(&panel).contains(&said));
    let command = Modifiers::COMMAND;
    let pressed = |pressed| RawInput {
        events: vec![Event::ModifiersChanged(command), key(pressed, command)],
        focused: true,
        ..RawInput::default()
    };
    assert!(wait(&panel, pressed(Key::Q)).1 && !wait(&panel, pressed(Key::S)).1, "Ctrl+Q quits");
    panel.compiling(Compilation { done: 27, all: 27 });
    assert!(waiting(&panel).contains(&"preparing the scene".to_owned()));
    window.panel.compiling(Compilation { done: 27, all: 27 });
    assert!(window.texts().iter().all(|text| !text.starts_with("compiling")));
}

/// A value of the command line beyond a slider's range stays as it is while nobody moves the slider.
#[test]
fn sliders_leave_values_alone() {
    let mut snapshot = snapshot();
    let choices = &mut snapshot.picture.choices;
    (choices.settings.image.spp, choices.settings.light_scale) = (65_536, 100.0);
    (choices.display.exposure, choices.pose.time) = (10.0, Some(30.0));
    snapshot.fov = Some(150.0);
    let mut window = Window::new(snapshot);
    for _ in 0..3 {
        let commands = window.commands(Vec::new(), Modifiers::NONE);
        assert!(commands.is_empty(), "{commands:?}");
    }
    let texts = window.texts();
    for value in ["65536", "100", "30", "150"] {
        assert!(texts.iter().any(|text| text.starts_with(value)), "{value} is not in {texts:?}");
    }
}

/// A scene that is read again may have fewer lights than before.
#[test]
fn a_light_that_is_gone_is_not_selected() {
    let mut snapshot = snapshot();
    let display = &mut snapshot.picture.choices.display;
    (display.overlay, display.light) = (Overlay::Classes, 1);
    let mut window = Window::new(snapshot);
    assert!(window.commands(Vec::new(), Modifiers::NONE).is_empty());
    window.snapshot.lights.pop();
    let requests = window.frame(Vec::new(), Modifiers::NONE).0;
    let [Request::Command(Command::Choose(choices))] = &requests[..] else { panic!("{requests:?}") };
    assert_eq!(choices.display.light, 0);
}

/// With a noise to reach, the panel offers only techniques whose error can be estimated.
#[test]
fn techniques_that_settings_exclude_are_not_offered() {
    let offered = |noise: Option<f64>| {
        let mut snapshot = snapshot();
        snapshot.picture.choices.settings.image.noise = noise;
        let selected = snapshot.picture.choices.settings.technique.name();
        let mut window = Window::new(snapshot);
        let list = window.find(selected);
        window.click(list);
        let texts = window.texts();
        ["path", "light-buffer", "voxel-tags", "photon-map"].map(|name| texts.iter().any(|text| text == name))
    };
    assert_eq!(offered(None), [true; 4]);
    assert_eq!(offered(Some(0.01)), [true, true, false, false]);
}

/// Lens and environment are at first those of the command line.
#[test]
fn sliders_begin_with_the_command_line() {
    let mut snapshot = snapshot();
    snapshot.has_panorama = true;
    snapshot.picture.choices.pose.environment_rotation = Some(45.5);
    snapshot.picture.eye.f_number = Some(5.6);
    let texts = Window::new(snapshot).texts();
    for text in ["45.5", "f-number", "5.6"] {
        assert!(texts.iter().any(|found| found.starts_with(text)), "{text:?} is not in {texts:#?}");
    }
}

/// Depth of field that ends with an orthographic camera is off for the next camera, too.
#[test]
fn depth_of_field_is_that_of_the_picture() {
    let mut snapshot = snapshot();
    snapshot.picture.eye.f_number = Some(5.6);
    let mut window = Window::new(snapshot);
    let mut has_f_number = |f_number, fov| {
        (window.snapshot.picture.eye.f_number, window.snapshot.fov) = (f_number, fov);
        window.texts().iter().any(|text| text.starts_with("f-number"))
    };
    let fov = Some(40.0);
    assert!(has_f_number(Some(5.6), fov));
    assert!(!has_f_number(None, None));
    assert!(!has_f_number(None, fov));
    assert!(has_f_number(Some(5.6), fov));
}

/// Another file has animations and variants of its own; what else was chosen stays.
#[test]
fn another_file_has_its_own_pose() {
    let mut snapshot = snapshot();
    let pose = &mut snapshot.picture.choices.pose;
    (pose.time, pose.variant) = (Some(1.0), Some("oak".into()));
    snapshot.picture.choices.display.exposure = 3.0;
    let mut window = Window::new(snapshot);
    let mut chosen = || {
        let requests = window.frame(vec![key(Key::Num2, Modifiers::NONE)], Modifiers::NONE).0;
        let [Request::Command(Command::Choose(choices))] = &requests[..] else { panic!("{requests:?}") };
        assert_eq!(choices.display.exposure, 3.0);
        let pose = choices.pose.clone();
        window.snapshot.picture.file = PathBuf::from("other.glb");
        window.snapshot.picture.choices.pose = Pose::default();
        pose
    };
    assert_eq!(chosen(), Pose { time: Some(1.0), variant: Some("oak".into()), ..Pose::default() });
    assert_eq!(chosen(), Pose::default());
}

#[test]
fn drags_move_the_camera() {
    let mut window = Window::new(snapshot());
    // The picture is 360 points high.
    let by = Vec2::new(36.0, -18.0);
    let none = Modifiers::NONE;
    assert_eq!(window.drag(PointerButton::Primary, by, none), ["Command(Orbit([-0.1, -0.05]))"].map(rounded));
    assert_eq!(window.drag(PointerButton::Middle, by, none), ["Command(Pan([-0.1, -0.05]))"].map(rounded));
    assert_eq!(window.drag(PointerButton::Primary, by, Modifiers::SHIFT), ["Command(Pan([-0.1, -0.05]))"].map(rounded));
}

/// As `Debug` prints the quotients of f32.
fn rounded(text: &str) -> String {
    text.replace("0.1", &format!("{:?}", f64::from(0.1f32))).replace("0.05", &format!("{:?}", f64::from(0.05f32)))
}

#[test]
fn keys_move_the_camera() {
    let mut window = Window::new(snapshot());
    window.frame(vec![Event::PointerMoved(PICTURE)], Modifiers::NONE);
    let w = window.commands(vec![key(Key::W, Modifiers::NONE)], Modifiers::NONE);
    assert!(w.len() == 1 && w[0].starts_with("Command(Fly([0.0, 0.0, 0.0"), "{w:?}");
    let release =
        Event::Key { key: Key::W, physical_key: None, pressed: false, repeat: false, modifiers: Modifiers::NONE };
    assert!(window.commands(vec![release], Modifiers::NONE).is_empty());
    assert_eq!(window.commands(vec![key(Key::Home, Modifiers::NONE)], Modifiers::NONE), ["Command(FrameAll)"]);
    assert_eq!(window.commands(vec![key(Key::F, Modifiers::NONE)], Modifiers::NONE), ["Command(FrameAt([0.5, 0.5]))"]);
    assert_eq!(window.commands(vec![key(Key::Escape, Modifiers::NONE)], Modifiers::NONE), ["Command(Unpick)"]);
    let last = window.commands(vec![key(Key::Num9, Modifiers::NONE)], Modifiers::NONE);
    assert!(last.len() == 1 && last[0].contains("overlay: Depth"), "{last:?}");
    let quit = window.commands(vec![key(Key::Q, Modifiers::COMMAND)], Modifiers::COMMAND);
    assert_eq!(quit, ["Quit"]);
}

#[test]
fn clicks_pick_and_press_buttons() {
    let mut window = Window::new(snapshot());
    assert_eq!(window.click(PICTURE), ["Command(Pick([0.5, 0.5]))"]);
    let copy = window.find("copy command");
    assert_eq!(window.click(copy), ["Copy"]);
    window.panel.copied("penumbra render x".into());
    assert!(window.texts().contains(&"penumbra render x".to_owned()));
    let save = window.find("save");
    assert_eq!(window.click(save), ["Command(Save(\"picture.png\"))"]);
    let save = window.find("save camera");
    let saved = r#"Command(SaveCamera { file: "folder/scene.view.glb", name: "view", replaces: false })"#;
    assert_eq!(window.click(save), [saved]);
    let denoised = window.find("denoised");
    let choice = window.click(denoised);
    assert!(choice.len() == 1 && choice[0].contains("denoised: true"), "{choice:?}");
}

/// A picture that follows the window is told its size once, and not that it has none.
#[test]
fn the_picture_follows_the_window() {
    let mut window = Window::new(snapshot());
    window.panel = Panel::new(true);
    let sizes = window.commands(Vec::new(), Modifiers::NONE);
    assert_eq!(sizes.len(), 1);
    assert!(sizes[0].starts_with("Command(Resize(["), "{sizes:?}");
    assert!(window.commands(Vec::new(), Modifiers::NONE).is_empty());
}

/// What is at a pixel is told.
#[test]
fn a_pixel_is_described() {
    let mut snapshot = snapshot();
    let hit = penumbra::internal::view::Hit {
        material: "oak".into(),
        position: glam::DVec3::new(1.0, 2.0, 3.0),
        normal: None,
        depth: 4.0,
    };
    let light = penumbra::internal::view::PickedLight {
        name: "lamp".into(),
        class: "boundary",
        visibility: 0.5,
        photons: [20.0, 16.0],
    };
    snapshot.picked = Some(penumbra::internal::view::Picked {
        at: [0.25, 0.75],
        hit: Some(hit),
        radiance: Some([0.1, 0.2, 0.3]),
        lights: vec![light],
        point: None,
        nearest: None,
    });
    let texts = Window::new(snapshot).texts();
    for text in
        ["material oak", "position 1.0000, 2.0000, 3.0000", "lamp: boundary, visibility 0.500, n_i 20.0, n_s 16.0"]
    {
        assert!(texts.iter().any(|found| found == text), "{text:?} is not in {texts:#?}");
    }
}
