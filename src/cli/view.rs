//! `penumbra view`.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::parser::ValueSource;
use clap::{ArgMatches, CommandFactory};
use glam::DVec3;
use penumbra::internal::render::film::View;
use penumbra::internal::scene::{Extent, LookAt};
use penumbra::internal::view::{Choices, Display, Eye, Overlay, Picture, Pose, Program, Shown, Source, Viewpoint};
use penumbra::settings::Denoise;
use penumbra::{Aov, Camera, Denoiser, Error, Result, Scene};

use super::options::{
    DeviceOptions, ExtentOptions, OidnOptions, RenderOptions, SceneOptions, camera_word, denoisers, finite,
};
use super::{CommandLine, Ending, cache, flags, print, say, shell};

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneOptions,

    /// Tone mapping: neutral (Khronos PBR Neutral), agx, standard (sRGB, clipped) or raw (linear values)
    #[arg(long, value_name = "VIEW", default_value_t = View::default(), help_heading = "Output")]
    view: View,

    /// Exposure, in stops
    #[arg(long, value_name = "EV", default_value_t = 0.0, value_parser = finite::<f32>, help_heading = "Output")]
    exposure: f32,

    /// Denoiser for the picture
    #[arg(long, value_name = "DENOISER", value_parser = denoisers(), default_value = "auto", help_heading = "Output")]
    denoise: Denoise,

    #[command(flatten)]
    oidn: OidnOptions,

    #[command(flatten)]
    settings: RenderOptions,

    #[command(flatten)]
    device: DeviceOptions,
}

pub fn run(arguments: &Arguments) -> Result<Ending> {
    arguments.settings.check(&ExtentOptions::default())?;
    arguments.oidn.check(arguments.denoise)?;
    let display = Display::open().map_err(|error| match error {
        Error::NoDisplay(problem) => {
            // The library of the window puts a location in its own source before the last colon.
            let problem = problem.rsplit(": ").next().unwrap_or(&problem).trim_end_matches('.');
            Error::NoDisplay(format!("{problem}; `penumbra render` needs none"))
        }
        other => other,
    })?;
    let (scene, camera) = arguments.scene.load(arguments.settings.aspect())?;
    scene.notes.iter().for_each(|note| say(format_args!("note: {note}")));
    let choices = choices(arguments, &camera)?;
    let program = Program {
        source: Arc::new(Options::new(arguments, &CommandLine::command().get_matches())),
        file: arguments.scene.scene.clone(),
        scene,
        choices,
        follows_window: !arguments.settings.has_size(),
        device: arguments.device.choice(),
        kernels: cache::kernels(),
        // Nobody may read it.
        copied: Box::new(|command| _ = print(&format!("{command}\n"))),
    };
    display.show(program)?;
    Ok(Ending::Done)
}

/// What the window shows at first.
fn choices(arguments: &Arguments, camera: &Camera) -> Result<Choices> {
    let settings = arguments.settings.settings(camera, &ExtentOptions::default())?;
    let display = Shown {
        overlay: Overlay::Picture,
        light: 0,
        view: arguments.view,
        exposure: arguments.exposure,
        denoised: arguments.denoise != Denoise::None,
    };
    Ok(Choices { settings, pose: arguments.scene.pose(), display })
}

/// The options that the copied command states itself: the window changes them, or they have other defaults in `render`.
const STATED: [&str; 23] = [
    "scene",
    "camera",
    "from",
    "look_from",
    "look_at",
    "look_up",
    "orthographic",
    "fov",
    "aperture",
    "at",
    "animation",
    "repeat",
    "variant",
    "environment_rotation",
    "view",
    "exposure",
    "denoise",
    "technique",
    "spp",
    "aov",
    "width",
    "height",
    "light_scale",
];

/// Options of the lens, besides its f-number.
const LENS: [&str; 2] = ["focus", "iris_blades"];

/// Options that place the camera.
const CAMERA: [&str; 6] = ["camera", "from", "look_from", "look_at", "look_up", "orthographic"];

/// The options of the command, for a session.
struct Options {
    scene: SceneOptions,
    oidn: OidnOptions,
    denoise: Denoise,
    /// The options of the command line that the window does not change, as they were given.
    kept: Vec<String>,
    /// The camera options, as given.
    camera: Vec<String>,
    /// The animation options.
    animation: Vec<String>,
    /// The options of the lens besides its f-number, without which they have no meaning.
    lens: Vec<String>,
}

impl Options {
    /// `matches` are those of the whole command line.
    fn new(arguments: &Arguments, matches: &ArgMatches) -> Options {
        let given = matches.subcommand_matches("view");
        let all = |wanted: &dyn Fn(&str) -> bool| given.map(|given| given_options(given, wanted)).unwrap_or_default();
        Options {
            scene: arguments.scene.clone(),
            oidn: arguments.oidn.clone(),
            denoise: arguments.denoise,
            kept: all(&|id| !STATED.contains(&id) && !LENS.contains(&id)),
            camera: all(&|id| CAMERA.contains(&id)),
            animation: all(&|id| ["animation", "repeat"].contains(&id)),
            lens: all(&|id| LENS.contains(&id)),
        }
    }

    /// The options that see what `eye` sees, where the file's cameras have these names.
    fn seen(&self, eye: &Eye, cameras: &[String]) -> SceneOptions {
        let scene = self.scene.clone().through(eye.fov, eye.f_number);
        match &eye.viewpoint {
            Viewpoint::Given => scene,
            // The field of view of the command belongs to the camera of the command.
            Viewpoint::Default => scene.through_camera(None, eye.fov),
            Viewpoint::File(index) => scene.through_camera(Some(camera_word(cameras, *index)), eye.fov),
            Viewpoint::Placed(view) => scene.placed(view),
        }
    }

    /// The options of the camera, where the file's cameras have these names.
    fn camera_options(&self, eye: &Eye, cameras: &[String]) -> Vec<String> {
        let mut options = match &eye.viewpoint {
            Viewpoint::Given => self.camera.clone(),
            Viewpoint::Default => Vec::new(),
            Viewpoint::File(index) => vec![format!("--camera={}", camera_word(cameras, *index))],
            Viewpoint::Placed(view) => {
                let numbers = |p: &[f64; 3]| p.map(|x| x.to_string()).join(",");
                let positions = [view.from, view.at].map(|position| numbers(&position.to_array()));
                let mut options = vec![format!("--look-from={}", positions[0]), format!("--look-at={}", positions[1])];
                if view.up != DVec3::Y {
                    options.push(format!("--look-up={}", numbers(&view.up.to_array())));
                }
                options.push(match view.extent {
                    Extent::FieldOfView(fov) => format!("--fov={fov}"),
                    Extent::Height(height) => format!("--orthographic={height}"),
                });
                options
            }
        };
        let is_placed = matches!(eye.viewpoint, Viewpoint::Placed(_));
        let fov = eye.fov.or(self.scene.fov().filter(|_| eye.viewpoint == Viewpoint::Given)).filter(|_| !is_placed);
        options.extend(fov.map(|fov| format!("--fov={fov}")));
        let is_orthographic = matches!(eye.viewpoint, Viewpoint::Placed(LookAt { extent: Extent::Height(_), .. }));
        if let Some(f_number) = eye.f_number.filter(|_| !is_orthographic) {
            options.push(format!("--aperture={f_number}"));
            options.extend(self.lens.iter().cloned());
        }
        options
    }
}

/// The options of the command line that are `wanted`, in the form of one word each.
fn given_options(given: &ArgMatches, wanted: &dyn Fn(&str) -> bool) -> Vec<String> {
    let command = CommandLine::command();
    let Some(view) = command.find_subcommand("view") else { return Vec::new() };
    let mut options = Vec::new();
    for argument in view.get_arguments() {
        let id = argument.get_id().as_str();
        let is_given =
            given.try_contains_id(id).unwrap_or(false) && given.value_source(id) == Some(ValueSource::CommandLine);
        let Some(name) = argument.get_long().filter(|_| is_given && wanted(id)) else { continue };
        if !argument.get_action().takes_values() {
            options.push(format!("--{name}"));
            continue;
        }
        let values = given.get_raw(id).into_iter().flatten();
        options.extend(values.map(|value| format!("--{name}={}", value.to_string_lossy())));
    }
    options
}

impl Source for Options {
    fn load(&self, file: &Path, pose: &Pose, files: &mut Vec<PathBuf>) -> Result<Scene> {
        let options = self.scene.clone().of_file(file, pose);
        let mut scene = options.load_and_list(pose.time, files)?;
        if let Some(panorama) = options.load_panorama()? {
            options.set_panorama(&mut scene, &panorama)?;
        }
        Ok(scene)
    }

    fn camera(&self, scene: &Scene, eye: &Eye, aspect: f32) -> Result<Camera> {
        let cameras: Vec<String> = scene.cameras.iter().map(|camera| camera.name.clone()).collect();
        self.seen(eye, &cameras).camera(scene, aspect)
    }

    fn eye(&self) -> Eye {
        Eye { f_number: self.scene.f_number(), ..Eye::default() }
    }

    fn denoiser(&self) -> (Denoiser, Option<String>) {
        match self.oidn.denoiser(self.denoise) {
            Ok(denoiser) => (denoiser, None),
            Err(problem) => (Denoiser::default(), Some(flags::with_flags(&problem.to_string()).into_owned())),
        }
    }

    fn command(&self, picture: &Picture, cameras: &[String]) -> String {
        let Picture { file, eye, choices } = picture;
        let Choices { settings, pose, display } = choices;
        let image = &settings.image;
        let mut words = vec!["penumbra".to_owned(), "render".to_owned(), file.display().to_string()];
        words.extend(self.camera_options(eye, cameras));
        if let Some(time) = pose.time {
            words.push(format!("--at={time}"));
            words.extend(self.animation.iter().cloned());
        }
        words.extend(pose.variant.iter().map(|variant| format!("--variant={variant}")));
        words.extend(pose.environment_rotation.map(|degrees| format!("--environment-rotation={degrees}")));
        words.push(format!("--technique={}", settings.technique));
        words.push(format!("--width={}", image.width));
        words.push(format!("--height={}", image.height));
        words.push(format!("--spp={}", image.spp));
        if settings.light_scale != 1.0 {
            words.push(format!("--light-scale={}", settings.light_scale));
        }
        words.push(format!("--view={}", display.view));
        if display.exposure != 0.0 {
            words.push(format!("--exposure={}", display.exposure));
        }
        // Also for a raw picture: the denoiser decides on batches, and on samples with --noise.
        words.push(format!("--denoise={}", self.denoise.name()));
        words.extend(self.kept.iter().cloned());
        if display.overlay.requires_photons() && settings.visibility_map.photons_per_light.is_none() {
            words.push(format!("--photons={}", settings.photons_per_light()));
        }
        let aovs: BTreeSet<Aov> = image.aovs.iter().copied().chain(display.overlay.aov()).collect();
        if !aovs.is_empty() {
            words.push(format!("--aov={}", aovs.iter().map(|aov| aov.name()).collect::<Vec<_>>().join(",")));
        }
        // A .png holds one picture alone: the denoised one if there is one.
        let is_png = aovs.is_empty() && (display.denoised || self.denoise == Denoise::None);
        words.extend(["-o".to_owned(), if is_png { "picture.png" } else { "picture.exr" }.to_owned()]);
        shell::quoted(&words)
    }

    fn files(&self) -> Vec<PathBuf> {
        self.scene.other_files()
    }

    fn has_panorama(&self) -> bool {
        self.scene.has_panorama()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;
    use std::sync::Arc;

    use clap::{CommandFactory, Parser};
    use kernel_kit::Gpu;
    use penumbra::internal::view::{Command as SessionCommand, Eye, Overlay, Session, Shown, Source, State, Viewpoint};
    use penumbra::{Image, ImportOptions, Scene};

    use super::super::{Command, CommandLine, render};
    use super::{Options, choices};

    /// The window begins with what the command says.
    #[test]
    fn the_environment_is_turned_at_first() {
        let rotation = |options: &[&str]| {
            let line = CommandLine::parse_from([&["penumbra", "view", "scene.glb"], options].concat());
            let Command::View(arguments) = line.command else { panic!("another command") };
            arguments.scene.pose().environment_rotation
        };
        let panorama = ["--environment", "sky.exr"];
        assert_eq!(rotation(&[&panorama[..], &["--environment-rotation", "45"]].concat()), Some(45.0));
        assert_eq!(rotation(&panorama), None);
    }

    /// A camera selected in the window is that camera of the file, whatever the cameras are called and whichever field
    /// of view the command gives to its own. The copied command has the same camera.
    #[test]
    fn a_selected_camera_is_that_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cameras.gltf");
        let names = ["1", "0", "twin", "twin", "5", "00", "side"];
        let nodes = names.iter().enumerate().map(|(i, name)| format!(r#"{{"camera": {i}, "name": "{name}"}}"#));
        let nodes = nodes.collect::<Vec<_>>().join(", ");
        let perspective =
            |i: usize| format!(r#"{{"type": "perspective", "perspective": {{"yfov": 0.{}, "znear": 0.1}}}}"#, i + 1);
        let perspectives = (0..names.len() - 1).map(perspective).collect::<Vec<_>>().join(", ");
        let orthographic = r#"{"xmag": 1, "ymag": 1, "znear": 0, "zfar": 9}"#;
        let text = format!(
            r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0, 1, 2, 3, 4, 5, 6]}}],
            "nodes": [{nodes}],
            "cameras": [{perspectives}, {{"type": "orthographic", "orthographic": {orthographic}}}]}}"#
        );
        fs::write(&file, text).unwrap();
        let words = ["penumbra", "view", file.to_str().unwrap(), "--fov", "30"];
        let Command::View(arguments) = CommandLine::parse_from(words).command else { panic!("another command") };
        let options = Options::new(&arguments, &CommandLine::command().get_matches_from(words));
        let scene = arguments.scene.load_at(None).unwrap();
        let of_command = |eye: &Eye| {
            let camera = options.camera_options(eye, &names.map(str::to_owned));
            let line = ["penumbra", "render", words[2], "-o", "a.png"].map(str::to_owned).into_iter().chain(camera);
            let Command::Render(arguments) = CommandLine::parse_from(line).command else { panic!("another command") };
            arguments.scene.camera(&scene, 1.0).unwrap()
        };
        for (index, expected) in scene.cameras.iter().enumerate() {
            let eye = Eye { viewpoint: Viewpoint::File(index), ..Eye::default() };
            assert_eq!(options.camera(&scene, &eye, 1.0).unwrap(), *expected, "camera {index}");
            assert_eq!(of_command(&eye), *expected, "camera {index}");
        }
        // A field of view that is chosen in the window is for the camera that it shows.
        let wide = Eye { viewpoint: Viewpoint::File(2), fov: Some(60.0), ..Eye::default() };
        for eye in [wide, Eye::default()] {
            assert_eq!(of_command(&eye), options.camera(&scene, &eye, 1.0).unwrap(), "{eye:?}");
        }
    }

    /// The picture is denoised while that is shown, and at its end for the files; otherwise time is not spent on it.
    #[test]
    fn what_is_not_shown_is_not_denoised() {
        let folder = tempfile::tempdir().unwrap();
        let saved = folder.path().join("saved.exr");
        let device = std::env::var("PENUMBRA_DEVICE").unwrap_or("software".into());
        let gpu = Gpu::open(&device.parse().unwrap()).unwrap();
        let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/box.glb");
        let words = format!("penumbra view --width 24 --height 18 --spp 20 --device {device} --denoise statistical");
        let words: Vec<&str> = words.split(' ').chain([scene]).collect();
        let Command::View(arguments) = CommandLine::parse_from(&words).command else { panic!("another command") };
        let options = Arc::new(Options::new(&arguments, &CommandLine::command().get_matches_from(&words)));
        for denoised in [false, true] {
            let (loaded, camera) = arguments.scene.load(1.0).unwrap();
            let mut choices = choices(&arguments, &camera).unwrap();
            choices.display.denoised = denoised;
            let mut session = Session::new(&gpu, State::new(options.clone(), scene.into(), loaded, choices));
            let mut before_the_end = Vec::new();
            loop {
                let (_, works) = session.step().unwrap();
                session.command(SessionCommand::Save(saved.clone()));
                let is_filtered = Image::read(&saved).unwrap().channel("denoised.R").is_some();
                if !works {
                    assert!(is_filtered, "{denoised}: the complete picture is raw");
                    break;
                }
                if !session.snapshot().is_complete {
                    before_the_end.push(is_filtered);
                }
            }
            // The first, small picture is raw in any case.
            assert!(before_the_end.len() > 3, "{before_the_end:?}");
            assert!(before_the_end[2..].iter().all(|is_filtered| *is_filtered == denoised), "{before_the_end:?}");
        }
    }

    /// A file that is opened in the window is shown even if it lacks the camera of the command. Its camera can move.
    #[test]
    fn another_file_may_lack_the_camera() {
        let file = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
        let [first, other] = ["scenes/box.glb", "tests/scene/poses/face.gltf"].map(file);
        let device = std::env::var("PENUMBRA_DEVICE").unwrap_or("software".into());
        let name = Scene::load(&first, &ImportOptions::default()).unwrap().cameras[0].name.clone();
        let words =
            ["penumbra", "view", "--width", "24", "--height", "18", "--spp", "1", "--device", &device, "--camera"];
        let words = [&words[..], &[&name, first.to_str().unwrap()]].concat();
        let Command::View(arguments) = CommandLine::parse_from(&words).command else { panic!("another command") };
        let options = Arc::new(Options::new(&arguments, &CommandLine::command().get_matches_from(&words)));
        let (scene, camera) = arguments.scene.load(1.0).unwrap();
        let choices = choices(&arguments, &camera).unwrap();
        let gpu = Gpu::open(&device.parse().unwrap()).unwrap();
        let mut session = Session::new(&gpu, State::new(options.clone(), first.clone(), scene, choices));
        let mut shown = |command| {
            session.command(command);
            while session.step().unwrap().1 {}
            session.snapshot()
        };
        let opened = shown(SessionCommand::Open(other.clone()));
        assert_eq!((opened.message, &opened.picture.eye.viewpoint), (None, &Viewpoint::Default));
        assert_eq!(opened.picture.file, other);
        let command = options.command(&opened.picture, &opened.cameras);
        assert!(!command.contains("--camera"), "{command}");
        let refused = shown(SessionCommand::Camera(Viewpoint::Given));
        assert!(refused.message.is_some_and(|message| message.contains(&name)));
        assert_eq!(refused.picture.eye.viewpoint, Viewpoint::Default);
        let moved = shown(SessionCommand::Orbit([0.1, 0.0]));
        assert!(matches!(moved.picture.eye.viewpoint, Viewpoint::Placed(_)), "{:?}", moved.message);
    }

    /// The copied command renders the bits of the picture that is shown, also where the denoiser, the user's channels
    /// or an overlay decide on samples, kernels or photons.
    #[test]
    fn a_copied_command_renders_the_picture() {
        let folder = tempfile::tempdir().unwrap();
        let [scene, shown, rendered] = ["box.glb", "shown.exr", "rendered.exr"].map(|name| folder.path().join(name));
        fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/box.glb"), &scene).unwrap();
        let device = std::env::var("PENUMBRA_DEVICE").unwrap_or("software".into());
        let gpu = Gpu::open(&device.parse().unwrap()).unwrap();
        for (given, overlay, denoised, file) in [
            ("--denoise statistical", Overlay::Picture, true, "picture.png"),
            ("--denoise statistical --noise 0.01", Overlay::Picture, false, "picture.exr"),
            ("--denoise none", Overlay::Cells, false, "picture.png"),
            ("--denoise none --photons 5000", Overlay::Cells, false, "picture.png"),
            ("--denoise none --aov shadow,N", Overlay::Depth, false, "picture.exr"),
        ] {
            let case = format!("{given}, {overlay:?}, denoised: {denoised}");
            let words = format!("penumbra view --width 48 --height 36 --spp 20 --device {device} {given}");
            let words: Vec<&str> = words.split(' ').chain([scene.to_str().unwrap()]).collect();
            let Command::View(arguments) = CommandLine::parse_from(&words).command else { panic!("another command") };
            let options = Arc::new(Options::new(&arguments, &CommandLine::command().get_matches_from(&words)));
            let (loaded, camera) = arguments.scene.load(1.0).unwrap();
            let mut choices = choices(&arguments, &camera).unwrap();
            choices.display = Shown { overlay, denoised, ..choices.display };
            let mut session = Session::new(&gpu, State::new(options.clone(), scene.clone(), loaded, choices));
            while session.step().unwrap().1 {}
            session.command(SessionCommand::Save(shown.clone()));
            let snapshot = session.snapshot();
            assert!(snapshot.is_complete, "{case}: {:?}", snapshot.message);
            let command = options.command(&snapshot.picture, &snapshot.cameras);
            assert!(command.ends_with(&format!(" -o {file}")), "{case}: {command}");
            let output = command.rfind(file).unwrap();
            let words = command[..output].split_whitespace().chain([rendered.to_str().unwrap(), "--quiet"]);
            let Command::Render(arguments) = CommandLine::parse_from(words).command else { panic!("another command") };
            render::run(&arguments).unwrap();
            let [shown, rendered] = [&shown, &rendered].map(|file| Image::read(file).unwrap());
            for name in ["R", "G", "B", "denoised.R", "denoised.G", "denoised.B"] {
                let bits =
                    |image: &Image| image.channel(name).map(|s| s.iter().map(|x| x.to_bits()).collect::<Vec<_>>());
                assert!(bits(&shown) == bits(&rendered), "{case}: {name} differs from {command}");
            }
        }
    }
}
