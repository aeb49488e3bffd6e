//! The window's sessions: the time to the first picture, of pictures while the camera moves, and memory over a thousand
//! movements. Run as `scripts/with-vulkan cargo bench --bench view [-- --memory] [-- FILE...]`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use kernel_kit::Gpu;
use penumbra::internal::render::film::View;
use penumbra::internal::scene::load_and_list;
use penumbra::internal::view::{
    Choices, Command, Eye, Overlay, Picture, Pose, Session, Shown, Source, State, Viewpoint,
};
use penumbra::settings::Denoise;
use penumbra::{Camera, Denoiser, Error, ImportOptions, Result, Scene, Settings};

const SIZE: [u32; 2] = [640, 360];

/// How long the camera moves.
const MOVES: Duration = Duration::from_secs(8);

const SCENES: [&str; 4] = ["box", "sphere", "crowd", "still_life"];

/// Scenes from files, without options, and denoised as the program does by itself.
struct Files;

impl Source for Files {
    fn load(&self, file: &Path, pose: &Pose, files: &mut Vec<PathBuf>) -> Result<Scene> {
        load_and_list(file, &ImportOptions { time: pose.time, ..ImportOptions::default() }, files)
    }

    fn camera(&self, scene: &Scene, eye: &Eye, _: f32) -> Result<Camera> {
        match &eye.viewpoint {
            Viewpoint::Placed(view) => scene.look_at(view).map_err(Error::Usage),
            _ => Ok(scene.cameras.first().cloned().unwrap_or_else(|| scene.frame_camera())),
        }
    }

    fn denoiser(&self) -> (Denoiser, Option<String>) {
        let library = std::env::var_os("OIDN_LIBRARY").map(PathBuf::from);
        (Denoiser::new(Denoise::Auto, library.as_deref()).unwrap(), None)
    }

    fn command(&self, _: &Picture, _: &[String]) -> String {
        String::new()
    }

    fn files(&self) -> Vec<PathBuf> {
        Vec::new()
    }

    fn has_panorama(&self) -> bool {
        false
    }
}

fn state(file: &Path, scene: Scene) -> State {
    let settings = Settings::default().with(|s| [s.image.width, s.image.height] = SIZE);
    let display = Shown { overlay: Overlay::Picture, light: 0, view: View::Neutral, exposure: 0.0, denoised: true };
    State::new(Arc::new(Files), file.to_owned(), scene, Choices { settings, pose: Pose::default(), display })
}

/// Back and forth, so that the camera stays where it sees something.
fn movement(step: usize) -> Command {
    let way = if (step / 40).is_multiple_of(2) { 1.0 } else { -1.0 };
    Command::Orbit([0.004 * way, 0.001 * way])
}

fn milliseconds(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

fn measure(gpu: &Gpu, file: &Path) {
    let begun = Instant::now();
    let scene = Files.load(file, &Pose::default(), &mut Vec::new()).unwrap();
    let loaded = begun.elapsed();
    let mut session = Session::new(gpu, state(file, scene));
    let begun = Instant::now();
    let first = session.step().unwrap().0.unwrap();
    let took = begun.elapsed();
    println!(
        "{}: read in {:.0} ms, first picture of {} x {} pixels after {:.0} ms more",
        file.display(),
        milliseconds(loaded),
        first.size[0],
        first.size[1],
        milliseconds(took)
    );
    let begun = Instant::now();
    let mut times = Vec::new();
    let mut sizes = Vec::new();
    for step in 0.. {
        let frame = Instant::now();
        session.command(movement(step));
        let Some(snapshot) = session.step().unwrap().0 else { continue };
        times.push(frame.elapsed());
        sizes.push(snapshot.size);
        assert_eq!(snapshot.message, None);
        if begun.elapsed() > MOVES {
            break;
        }
    }
    let pictures = times.len() as f64 / begun.elapsed().as_secs_f64();
    let last = sizes.last().unwrap();
    times.sort();
    println!(
        "    moving: {pictures:.1} pictures a second; {:.0} ms median, {:.0} ms at 90 % of {}; {} x {} pixels last",
        milliseconds(times[times.len() / 2]),
        milliseconds(times[times.len() * 9 / 10]),
        times.len(),
        last[0],
        last[1]
    );
}

/// Memory of the process in MiB, and of the device.
fn memory(gpu: &Gpu) -> [f64; 2] {
    gpu.wait("memory").unwrap();
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmRSS")).unwrap_or_default();
    let resident: f64 = line.split_whitespace().nth(1).and_then(|kib| kib.parse().ok()).unwrap_or(f64::NAN);
    let device = gpu.device.generate_allocator_report().map_or(f64::NAN, |report| report.total_allocated_bytes as f64);
    [resident / 1024.0, device / 1024.0 / 1024.0]
}

fn measure_memory(gpu: &Gpu, file: &Path) {
    let scene = Files.load(file, &Pose::default(), &mut Vec::new()).unwrap();
    let mut session = Session::new(gpu, state(file, scene));
    println!("{}: resident and device memory in MiB", file.display());
    for step in 0..=1000 {
        session.command(movement(step));
        session.step().unwrap();
        if step % 200 == 0 {
            let [resident, device] = memory(gpu);
            println!("    after {step} movements: {resident:.0} and {device:.0}");
        }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let own = |name: &&str| Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.glb"));
    let mut files: Vec<PathBuf> = arguments.iter().filter(|name| !name.starts_with("--")).map(PathBuf::from).collect();
    if files.is_empty() {
        files = SCENES.iter().map(own).collect();
    }
    let of_memory = arguments.iter().any(|argument| argument == "--memory");
    for file in files {
        // Each begins with a device that keeps no kernels.
        let gpu = Gpu::open(&"software".parse().unwrap()).unwrap();
        if of_memory { measure_memory(&gpu, &file) } else { measure(&gpu, &file) }
    }
}
