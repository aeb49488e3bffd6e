//! Running the program.

use std::ffi::OsStr;
use std::path::PathBuf;
#[cfg(unix)]
use std::process::Child;
use std::process::{Command, Output};

pub const BOX: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/box.glb");
pub const STILL_LIFE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/still_life.glb");

/// A folder that is removed when it is dropped.
pub fn folder() -> tempfile::TempDir {
    tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap()
}

/// The device of the tests: lavapipe unless `PENUMBRA_DEVICE` names another.
pub fn device() -> String {
    std::env::var("PENUMBRA_DEVICE").unwrap_or_else(|_| "software".into())
}

/// Open Image Denoise, by the variable that the script sets.
pub fn oidn_library() -> PathBuf {
    let library = std::env::var_os("OIDN_LIBRARY").map(PathBuf::from).filter(|library| library.exists());
    library.expect("OIDN_LIBRARY names no library: run the tests by `scripts/with-vulkan cargo test`, which fetches it")
}

/// The program, with `arguments` split at spaces, then `files`.
pub fn penumbra(arguments: &str, files: &[&dyn AsRef<OsStr>]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_penumbra"));
    command.args(arguments.split_whitespace()).args(files);
    // Mesa complains on stderr where it is not set.
    command.env("XDG_RUNTIME_DIR", env!("CARGO_TARGET_TMPDIR"));
    // Only the tests of denoising name a library; the PNGs of the others stay raw.
    command.env_remove("OIDN_LIBRARY");
    // Tests run side by side, so their times do not show the machine's speed: they stay out of the user's cache folder,
    // where the driver still finds what it has compiled.
    if let Some(folder) = dirs::cache_dir().filter(|_| std::env::var_os("MESA_SHADER_CACHE_DIR").is_none()) {
        command.env("MESA_SHADER_CACHE_DIR", folder);
    }
    command.env("XDG_CACHE_HOME", concat!(env!("CARGO_TARGET_TMPDIR"), "/cache"));
    command
}

/// Sends a signal, such as "-INT", to a process that the test started. A shell sends it, since minimal systems have no
/// program `kill`.
#[cfg(unix)]
pub fn signal(child: &Child, signal: &str) {
    let command = format!("kill {signal} {}", child.id());
    assert!(Command::new("sh").args(["-c", &command]).status().unwrap().success());
}

/// Runs the program, with arguments as for [`penumbra`].
pub fn run(arguments: &str, files: &[&dyn AsRef<OsStr>]) -> Answer {
    Answer::of(&mut penumbra(arguments, files))
}

/// The output and exit code of the program.
#[derive(Debug)]
pub struct Answer {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Answer {
    pub fn of(command: &mut Command) -> Self {
        Answer::from(command.output().unwrap())
    }

    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|problem| panic!("{problem}: {self:?}"))
    }

    #[track_caller]
    pub fn assert_done(&self) -> &Self {
        assert_eq!(self.code, Some(0), "{self:?}");
        self
    }

    /// One line on stderr, with that exit code, that holds all of `words`.
    #[track_caller]
    pub fn assert_refused(&self, code: i32, words: &[&str]) {
        assert_eq!(self.code, Some(code), "{self:?}");
        assert_eq!(self.stdout, "");
        let line = self.stderr.strip_prefix("penumbra: error: ").unwrap_or_else(|| panic!("{self:?}"));
        assert_eq!(line.lines().count(), 1, "{self:?}");
        for word in words {
            assert!(line.contains(word), "{word:?} is not in {line:?}");
        }
    }
}

impl From<Output> for Answer {
    fn from(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Answer { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
    }
}

/// Whether the machine certainly has fewer bytes of memory than these.
pub fn lacks(bytes: u64) -> bool {
    let info = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let total = |name: &str| -> Option<u64> {
        info.lines().find_map(|line| line.strip_prefix(name))?.trim().strip_suffix(" kB")?.parse().ok()
    };
    let lacks = total("MemTotal:").zip(total("SwapTotal:")).is_some_and(|(ram, swap)| (ram + swap) * 1024 <= bytes);
    if !lacks {
        eprintln!("this machine may have room for it");
    }
    lacks
}
