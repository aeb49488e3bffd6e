//! A display without a screen, the program in it, and synthetic input.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Maximum time that anything here may take. A machine that builds at the same time is slow.
const PATIENCE: Duration = Duration::from_secs(90);

/// Size of the screen.
const SCREEN: [usize; 2] = [900, 600];

/// A display.
pub struct Display {
    server: Child,
    name: String,
    folder: tempfile::TempDir,
}

impl Display {
    /// Starts a server on a number that is free.
    pub fn start() -> Display {
        let folder = crate::setup::folder();
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-nolisten", "tcp", "-fbdir"])
            .arg(folder.path())
            .args(["-screen", "0", &format!("{}x{}x24", SCREEN[0], SCREEN[1])])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("no Xvfb: run the tests by `scripts/with-vulkan cargo test`, which installs it");
        let mut number = String::new();
        BufReader::new(server.stdout.as_mut().unwrap()).read_line(&mut number).unwrap();
        Display { server, name: format!(":{}", number.trim()), folder }
    }

    /// The screen, as 8-bit RGB. The server keeps it in a file of the format XWD.
    pub fn screenshot(&self) -> Screenshot {
        let bytes = fs::read(self.folder.path().join("Xvfb_screen0")).unwrap();
        let word = |index: usize| u32::from_be_bytes(bytes[4 * index..4 * index + 4].try_into().unwrap()) as usize;
        let (header, width, height, stride, colours) = (word(0), word(4), word(5), word(12), word(19));
        assert_eq!((word(11), [width, height]), (32, SCREEN), "bits of a pixel, and size");
        let pixels = &bytes[header + 12 * colours..];
        // Blue comes first.
        let pixel = |i: usize| -> [u8; 3] {
            let at = i / width * stride + i % width * 4;
            [pixels[at + 2], pixels[at + 1], pixels[at]]
        };
        Screenshot { size: SCREEN, pixels: (0..width * height).map(pixel).collect() }
    }

    /// Runs xdotool.
    pub fn input(&self, arguments: &str) {
        let status = Command::new("xdotool").env("DISPLAY", &self.name).args(arguments.split(' ')).status();
        let status = status.expect("no xdotool: run the tests by `scripts/with-vulkan cargo test`, which installs it");
        assert!(status.success(), "xdotool {arguments}");
    }

    /// Its name, for the environment variable `DISPLAY`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Waits for the window, and gives it the keyboard: no window manager does.
    pub fn focus(&self) {
        self.input("search --sync --onlyvisible --name Penumbra windowfocus --sync");
    }

    /// Resizes the window.
    pub fn resize(&self, [width, height]: [usize; 2]) {
        self.input(&format!("search --name Penumbra windowsize {width} {height}"));
    }

    /// Starts the program in it.
    pub fn run(&self, arguments: &str) -> Program<'_> {
        self.run_with(arguments, &[])
    }

    /// Starts the program in it, with these environment variables.
    pub fn run_with(&self, arguments: &str, variables: &[(&str, &Path)]) -> Program<'_> {
        let mut command = program();
        command.envs(variables.iter().copied());
        command.env("DISPLAY", &self.name).args(arguments.split(' ')).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let stdout = BufReader::new(child.stdout.take().unwrap());
        Program { display: self, child, stdout }
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// The program, without a display.
pub fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_penumbra"));
    for variable in ["DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET", "OIDN_LIBRARY"] {
        command.env_remove(variable);
    }
    // Mesa complains on stderr where it is not set.
    command.env("XDG_RUNTIME_DIR", env!("CARGO_TARGET_TMPDIR"));
    command
}

/// The program in its window.
pub struct Program<'a> {
    display: &'a Display,
    child: Child,
    stdout: BufReader<ChildStdout>,
}

impl Program<'_> {
    /// Waits until the screen is as `is` wants it.
    #[track_caller]
    pub fn wait(&mut self, what: &str, is: impl Fn(&Screenshot) -> bool) -> Screenshot {
        let begun = Instant::now();
        loop {
            let screenshot = self.display.screenshot();
            if is(&screenshot) {
                return screenshot;
            }
            if let Some(status) = self.child.try_wait().unwrap() {
                panic!("{what}: ended with {status}: {}", self.stderr());
            }
            if begun.elapsed() > PATIENCE {
                let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("view.actual.png");
                screenshot.save(&file);
                panic!("{what}: not after {PATIENCE:?}; the screen is in {}", file.display());
            }
            sleep(Duration::from_millis(50));
        }
    }

    /// Waits until nothing has changed for a second.
    #[track_caller]
    pub fn wait_for_rest(&mut self) -> Screenshot {
        let mut last = self.display.screenshot();
        let mut since = Instant::now();
        let begun = Instant::now();
        while since.elapsed() < Duration::from_secs(1) {
            assert!(begun.elapsed() < PATIENCE, "the window does not rest");
            sleep(Duration::from_millis(50));
            let screenshot = self.display.screenshot();
            if screenshot != last {
                (last, since) = (screenshot, Instant::now());
            }
        }
        last
    }

    /// Copies its command until that is as `is` wants it, and the same twice: events are still under way before.
    #[track_caller]
    pub fn copied(&mut self, is: impl Fn(&str) -> bool) -> String {
        let begun = Instant::now();
        let mut last = String::new();
        while begun.elapsed() < PATIENCE {
            self.display.input("key ctrl+c");
            let mut line = String::new();
            self.stdout.read_line(&mut line).unwrap();
            let line = line.trim_end();
            if line == last && is(line) {
                return last;
            }
            line.clone_into(&mut last);
            sleep(Duration::from_secs(1));
        }
        panic!("the command is {last}");
    }

    /// Ends it by its keys, and returns the exit code.
    pub fn quit(mut self) -> Option<i32> {
        self.display.input("key ctrl+q");
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            sleep(Duration::from_millis(50));
        }
        panic!("it does not end");
    }

    fn stderr(&mut self) -> String {
        let mut text = String::new();
        self.child.stderr.as_mut().unwrap().read_to_string(&mut text).unwrap();
        text
    }
}

impl Drop for Program<'_> {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What the screen shows.
#[derive(Clone, PartialEq)]
pub struct Screenshot {
    size: [usize; 2],
    pixels: Vec<[u8; 3]>,
}

impl Screenshot {
    /// From a file.
    pub fn read(path: &Path) -> Screenshot {
        let image = image::open(path).unwrap().into_rgb8();
        let size = [image.width() as usize, image.height() as usize];
        Screenshot { size, pixels: image.pixels().map(|pixel| pixel.0).collect() }
    }

    /// The part of that size whose first pixel is at `x`, `y`.
    pub fn part(&self, [x, y]: [usize; 2], size: [usize; 2]) -> Screenshot {
        let row = |row: usize| &self.pixels[(y + row) * self.size[0] + x..][..size[0]];
        Screenshot { size, pixels: (0..size[1]).flat_map(row).copied().collect() }
    }

    /// The mean of all bytes.
    pub fn mean(&self) -> f64 {
        let sum: f64 = self.pixels.as_flattened().iter().map(|x| f64::from(*x)).sum();
        sum / (3 * self.pixels.len()) as f64
    }

    /// Writes a PNG, for those who look into a failure.
    pub fn save(&self, path: &Path) {
        let bytes: Vec<u8> = self.pixels.as_flattened().to_vec();
        image::RgbImage::from_raw(self.size[0] as u32, self.size[1] as u32, bytes).unwrap().save(path).unwrap();
    }
}
