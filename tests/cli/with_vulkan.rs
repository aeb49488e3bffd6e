//! `scripts/with-vulkan` on made-up machines: every program that it could call is a stub in a folder that
//! is the whole of PATH, and drivers are manifests in a folder that XDG_DATA_DIRS names.
//!
//! The loader, and so the script, also looks in /etc/vulkan, which a test cannot hide. Hence machines without
//! any driver run `cargo test` here, which uses lavapipe whatever a GPU's driver has put there.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scripts/with-vulkan");
const LAVAPIPE: &str = "lvp_icd.x86_64.json";
const GPU: &str = "nvidia_icd.json";

struct Machine {
    root: PathBuf,
}

impl Machine {
    /// A machine with a loader, compilers, a display and cargo, but with no driver and no package manager.
    fn new(name: &str) -> Self {
        let root = Path::new(env!("CARGO_TARGET_TMPDIR")).join("with_vulkan").join(name);
        let _ = fs::remove_dir_all(&root);
        for folder in ["bin", "share/vulkan/icd.d", "tmp"] {
            fs::create_dir_all(root.join(folder)).unwrap();
        }
        let machine = Machine { root };
        for tool in ["bash", "cat", "env", "grep", "mkdir", "mktemp", "mv", "rm", "sh", "tee"] {
            let real = ["/bin", "/usr/bin", "/usr/local/bin"].map(|folder| Path::new(folder).join(tool));
            let real = real.iter().find(|path| path.exists()).unwrap_or_else(|| panic!("no {tool} on this machine"));
            symlink(real, machine.root.join("bin").join(tool)).unwrap();
        }
        machine.stub("ldconfig", "echo ' libvulkan.so.1 (libc6,x86-64) => /lib/libvulkan.so.1'");
        machine.stub("id", "echo 0");
        for tool in ["cc", "c++", "Xvfb", "xdotool"] {
            machine.stub(tool, "");
        }
        machine.stub("cargo", r#"echo "cargo $*"; env >"$ROOT/cargo.env"; exit 7"#);
        machine
    }

    /// A program of that name.
    fn stub(&self, name: &str, body: &str) {
        let path = self.root.join("bin").join(name);
        fs::write(&path, format!("#!/usr/bin/env bash\n{body}\n")).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o755)).unwrap();
    }

    /// A package manager that writes down its arguments, talks on stdout and then runs `effect`.
    fn manager(&self, name: &str, effect: &str) {
        self.stub(name, &format!("echo \"{name} $*\" >>\"$ROOT/log\"; echo chatter; {effect}"));
    }

    fn sudo(&self) {
        self.stub("id", "echo 1000");
        self.stub("sudo", r#"echo "sudo $*" >>"$ROOT/log"; exec "$@""#);
    }

    fn driver(&self, manifest: &str) {
        fs::write(self.root.join("share/vulkan/icd.d").join(manifest), "{}").unwrap();
    }

    fn run(&self, arguments: &[&str], environment: &[(&str, &str)]) -> Output {
        Command::new(SCRIPT)
            .args(arguments)
            .env_clear()
            .env("PATH", self.root.join("bin"))
            .env("HOME", &self.root)
            .env("XDG_CONFIG_DIRS", self.root.join("etc"))
            .env("XDG_DATA_DIRS", self.root.join("share"))
            .env("TMPDIR", self.root.join("tmp"))
            .env("ROOT", &self.root)
            // Nothing is fetched for the tests' denoiser, unless a test empties this.
            .env("OIDN_LIBRARY", "libOpenImageDenoise.so.2")
            .env("CARGO_TARGET_DIR", self.root.join("target"))
            .envs(environment.iter().copied())
            .output()
            .unwrap()
    }

    /// The calls of package managers and sudo, one per line.
    fn log(&self) -> String {
        fs::read_to_string(self.root.join("log")).unwrap_or_default()
    }

    /// The value of a variable as the command saw it.
    fn variable(&self, name: &str) -> Option<String> {
        let environment = fs::read_to_string(self.root.join("cargo.env")).unwrap();
        environment.lines().find_map(|line| Some(line.strip_prefix(name)?.strip_prefix('=')?.to_owned()))
    }
}

/// Shell that puts lavapipe's manifest where the loader looks, as its package does.
const INSTALL: &str = r#"echo {} >"$ROOT/share/vulkan/icd.d/lvp_icd.x86_64.json""#;

fn stdout(output: &Output) -> &str {
    std::str::from_utf8(&output.stdout).unwrap()
}

fn stderr(output: &Output) -> &str {
    std::str::from_utf8(&output.stderr).unwrap()
}

/// The command ran with these arguments, its output and exit code came through, and nothing else was printed on stdout.
#[track_caller]
fn assert_ran(output: &Output, command: &str) {
    assert_eq!(stdout(output), format!("{command}\n"), "stderr: {}", stderr(output));
    assert_eq!(output.status.code(), Some(7));
}

/// The command did not run; the exit code is that of a missing device, and stderr names `what`.
#[track_caller]
fn assert_refused(output: &Output, what: &str) {
    assert_eq!(output.status.code(), Some(4), "stderr: {}", stderr(output));
    assert_eq!(stdout(output), "");
    assert!(stderr(output).contains(what), "{what:?} is not in {:?}", stderr(output));
}

#[test]
fn a_machine_with_a_driver_just_runs_the_command() {
    let machine = Machine::new("driver");
    machine.manager("apt-get", INSTALL);
    machine.driver(LAVAPIPE);
    let output = machine.run(&["cargo", "test", "--", "a b"], &[]);
    assert_ran(&output, "cargo test -- a b");
    assert_eq!(stderr(&output), "");
    assert_eq!(machine.log(), "");
    assert_eq!(machine.variable("VK_DRIVER_FILES"), None, "a GPU would disappear");
    assert_eq!(machine.variable("VK_ICD_FILENAMES"), None, "a GPU would disappear");
}

#[test]
fn each_package_manager_installs_lavapipe() {
    let apt = "env DEBIAN_FRONTEND=noninteractive apt-get";
    let cases = [
        (
            "apt-get",
            vec![
                format!("{apt} update -q"),
                format!("{apt} install -qy --no-install-recommends libvulkan1 mesa-vulkan-drivers"),
            ],
        ),
        ("dnf", vec!["dnf install -y vulkan-loader mesa-vulkan-drivers".into()]),
        ("pacman", vec!["pacman -S --needed --noconfirm vulkan-icd-loader vulkan-swrast".into()]),
    ];
    for (manager, calls) in cases {
        for root in [true, false] {
            let machine = Machine::new(&format!("{manager}-{root}"));
            machine.manager(manager, INSTALL);
            if !root {
                machine.sudo();
            }
            let output = machine.run(&["cargo", "test"], &[]);
            assert_ran(&output, "cargo test");
            assert!(stderr(&output).starts_with("with-vulkan: missing: lavapipe; installing "), "{}", stderr(&output));
            let mut expected = String::new();
            for call in &calls {
                if !root {
                    expected += &format!("sudo {call}\n");
                }
                let called = call.find(manager).map(|at| &call[at..]).unwrap();
                expected += &format!("{called}\n");
            }
            assert_eq!(machine.log(), expected);
        }
    }
}

#[test]
fn stale_package_lists_are_fetched_anew() {
    let machine = Machine::new("stale");
    machine.manager("pacman", &format!("[[ $1 == -Sy ]] || exit 1; {INSTALL}"));
    assert_ran(&machine.run(&["cargo", "test"], &[]), "cargo test");
    assert_eq!(machine.log().lines().count(), 2);

    let machine = Machine::new("failed-update");
    machine.manager("apt-get", &format!("[[ $1 == install ]] || exit 100; {INSTALL}"));
    assert_ran(&machine.run(&["cargo", "test"], &[]), "cargo test");
}

#[test]
fn no_install_refuses_and_names_the_packages() {
    for (manager, packages) in [
        ("apt-get", "install libvulkan1 mesa-vulkan-drivers"),
        ("dnf", "install vulkan-loader mesa-vulkan-drivers"),
        ("pacman", "install vulkan-icd-loader vulkan-swrast"),
    ] {
        let machine = Machine::new(&format!("no-install-{manager}"));
        machine.manager(manager, INSTALL);
        assert_refused(&machine.run(&["--no-install", "cargo", "test"], &[]), packages);
        assert_eq!(machine.log(), "");
        machine.driver(LAVAPIPE);
        assert_ran(&machine.run(&["--no-install", "cargo", "test"], &[]), "cargo test");
    }
}

#[test]
fn tests_want_lavapipe_beside_a_gpu_unless_a_device_is_named() {
    let machine = Machine::new("gpu");
    machine.manager("apt-get", INSTALL);
    machine.driver(GPU);
    assert_ran(&machine.run(&["cargo", "run", "--", "test"], &[]), "cargo run -- test");
    assert_ran(&machine.run(&["cargo", "test"], &[("PENUMBRA_DEVICE", "gpu")]), "cargo test");
    assert_eq!(machine.log(), "");
    assert_ran(&machine.run(&["cargo", "+stable", "--locked", "test"], &[]), "cargo +stable --locked test");
    assert!(machine.log().contains("mesa-vulkan-drivers"));
}

#[test]
fn drivers_named_by_the_user_are_respected() {
    for name in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        let machine = Machine::new(&format!("named-{name}"));
        machine.manager("apt-get", INSTALL);
        let mine = machine.root.join("mine.json");
        fs::write(&mine, "{}").unwrap();
        let mine = mine.to_str().unwrap();
        let output = machine.run(&["cargo", "test"], &[(name, mine)]);
        assert_ran(&output, "cargo test");
        assert_eq!((stderr(&output), machine.log().as_str()), ("", ""));
        assert_eq!(machine.variable(name).as_deref(), Some(mine));

        let output = machine.run(&["cargo", "test"], &[(name, "/nonexistent/icd.json")]);
        assert_ran(&output, "cargo test");
        assert!(stderr(&output).contains("/nonexistent/icd.json"));
    }
}

#[test]
fn a_missing_loader_or_linker_is_installed_too() {
    let machine = Machine::new("no-loader");
    machine.driver(LAVAPIPE);
    machine.stub("ldconfig", r#"[[ ! -e $ROOT/log ]] || echo libvulkan.so.1"#);
    machine.manager("dnf", "");
    assert_ran(&machine.run(&["cargo", "test"], &[]), "cargo test");
    assert_eq!(machine.log(), "dnf install -y vulkan-loader\n");

    let machine = Machine::new("no-linker");
    fs::remove_file(machine.root.join("bin/cc")).unwrap();
    machine.driver(LAVAPIPE);
    machine.manager("dnf", r#"mv "$ROOT/bin/not-cc" "$ROOT/bin/cc""#);
    machine.stub("not-cc", "");
    assert_ran(&machine.run(&["cargo", "test"], &[]), "cargo test");
    assert_eq!(machine.log(), "dnf install -y gcc\n");

    let machine = Machine::new("no-need-of-a-linker");
    fs::remove_file(machine.root.join("bin/cc")).unwrap();
    machine.driver(LAVAPIPE);
    machine.stub("render", "echo render; exit 7");
    assert_ran(&machine.run(&["render"], &[]), "render");
}

#[test]
fn a_missing_compiler_is_installed() {
    for (manager, package) in [("apt-get", "g++ libc6-dev"), ("dnf", "gcc-c++"), ("pacman", "gcc")] {
        let machine = Machine::new(&format!("no-compiler-{manager}"));
        fs::rename(machine.root.join("bin/c++"), machine.root.join("bin/not-c++")).unwrap();
        machine.driver(LAVAPIPE);
        machine.manager(manager, r#"[[ $1 == update ]] || mv "$ROOT/bin/not-c++" "$ROOT/bin/c++""#);
        assert_ran(&machine.run(&["cargo", "build"], &[]), "cargo build");
        assert!(machine.log().ends_with(&format!(" {package}\n")), "{}", machine.log());
    }
}

/// A machine whose cargo has another name, until something installs it.
fn machine_without_cargo(name: &str) -> Machine {
    let machine = Machine::new(&format!("no-cargo-{name}"));
    machine.driver(LAVAPIPE);
    fs::rename(machine.root.join("bin/cargo"), machine.root.join("bin/not-cargo")).unwrap();
    machine
}

/// Shell that puts cargo into the path, as a package does, and into rustup's folder, as its installer does.
const PACKAGE: &str = r#"mv "$ROOT/bin/not-cargo" "$ROOT/bin/cargo""#;
const INSTALLER: &str = r#"mkdir -p "$HOME/.cargo/bin"; mv "$ROOT/bin/not-cargo" "$HOME/.cargo/bin/cargo""#;

#[test]
fn a_missing_cargo_comes_with_the_package_of_rustup() {
    for (manager, call) in [
        ("apt-get", "install -qy --no-install-recommends rustup ca-certificates"),
        ("dnf", "install -y rustup"),
        ("pacman", "-S --needed --noconfirm rustup"),
    ] {
        let machine = machine_without_cargo(manager);
        machine.manager(manager, &format!("[[ $1 == update ]] || {PACKAGE}"));
        let output = machine.run(&["cargo", "build"], &[]);
        assert_ran(&output, "cargo build");
        assert_eq!(stderr(&output).lines().next(), Some("with-vulkan: missing: cargo; installing rustup"));
        assert!(machine.log().ends_with(&format!("{manager} {call}\n")), "{}", machine.log());
    }

    // Fedora's package has the installer alone.
    let machine = machine_without_cargo("init");
    machine.manager("dnf", r#"mv "$ROOT/bin/not-rustup-init" "$ROOT/bin/rustup-init""#);
    machine.stub("not-rustup-init", &format!(r#"echo "rustup-init $*" >>"$ROOT/log"; {INSTALLER}"#));
    assert_ran(&machine.run(&["cargo", "build"], &[]), "cargo build");
    let call = "rustup-init -y --no-modify-path --profile minimal --default-toolchain none\n";
    assert!(machine.log().ends_with(call), "{}", machine.log());
}

#[test]
fn a_missing_cargo_comes_by_rustups_installer_where_there_is_no_package() {
    let no_package = r#"[[ $* != *rustup* ]] || exit 100"#;
    let curl = format!(r#"echo "curl $*" >>"$ROOT/log"; echo 'echo "installer $*" >>"$ROOT/log"; {INSTALLER}'"#);
    let machine = machine_without_cargo("installer");
    machine.manager("apt-get", no_package);
    machine.stub("curl", &curl);
    for _ in 0..2 {
        assert_ran(&machine.run(&["cargo", "build"], &[]), "cargo build");
        let log = machine.log();
        assert!(log.contains("curl --proto =https -sSf https://static.rust-lang.org/rustup/rustup-init.sh\n"), "{log}");
        // The second time it is found in rustup's folder.
        assert_eq!(log.matches("installer -y --no-modify-path --profile minimal").count(), 1, "{log}");
    }

    // A machine that has not even curl, and is not root's.
    let machine = machine_without_cargo("no-curl");
    machine.sudo();
    machine.manager(
        "apt-get",
        &format!(r#"{no_package}; [[ $* != *curl* ]] || mv "$ROOT/bin/not-curl" "$ROOT/bin/curl""#),
    );
    machine.stub("not-curl", &curl);
    assert_ran(&machine.run(&["cargo", "build"], &[]), "cargo build");
    assert!(machine.log().contains("install -qy --no-install-recommends curl ca-certificates\n"), "{}", machine.log());

    let machine = machine_without_cargo("offline");
    machine.stub("curl", "exit 6");
    assert_refused(
        &machine.run(&["cargo", "build"], &[]),
        "cargo cannot be installed; install it from https://rustup.rs",
    );
}

#[test]
fn no_install_names_a_missing_cargo() {
    let machine = machine_without_cargo("no-install");
    machine.manager("apt-get", PACKAGE);
    assert_refused(&machine.run(&["--no-install", "cargo", "build"], &[]), "missing: cargo; cargo comes with rustup");
    assert_eq!(machine.log(), "");
    // Programs without cargo do not want it.
    machine.stub("render", "echo render; exit 7");
    assert_ran(&machine.run(&["render"], &[]), "render");
}

#[test]
fn the_tests_of_the_python_package_get_a_virtual_environment() {
    let machine = Machine::new("venv");
    machine.driver(LAVAPIPE);
    machine.stub("test-python", "echo test-python; exit 7");
    machine.stub("python3", r#"[[ -e $ROOT/log && $* == *"import ensurepip, venv"* ]]"#);
    machine.manager("apt-get", "");
    assert_ran(&machine.run(&["test-python"], &[]), "test-python");
    assert!(machine.log().ends_with("install -qy --no-install-recommends python3-venv\n"), "{}", machine.log());
}

#[test]
fn tests_get_a_display_without_a_screen() {
    let machine = Machine::new("no-display");
    fs::remove_file(machine.root.join("bin/Xvfb")).unwrap();
    machine.driver(LAVAPIPE);
    machine.manager("dnf", r#"mv "$ROOT/bin/not-Xvfb" "$ROOT/bin/Xvfb""#);
    machine.stub("not-Xvfb", "");
    machine.run(&["cargo", "run"], &[]);
    assert_eq!(machine.log(), "", "only tests open windows on it");
    assert_ran(&machine.run(&["cargo", "test"], &[]), "cargo test");
    let packages = "xorg-x11-server-Xvfb xdotool libX11-xcb libXcursor libXi libxkbcommon-x11";
    assert_eq!(machine.log(), format!("dnf install -y {packages}\n"));
}

#[test]
fn what_cannot_be_installed_is_an_error() {
    let machine = Machine::new("no-manager");
    assert_refused(&machine.run(&["cargo", "test"], &[]), "missing: lavapipe");

    let machine = Machine::new("no-sudo");
    machine.manager("apt-get", INSTALL);
    machine.stub("id", "echo 1000");
    assert_refused(&machine.run(&["cargo", "test"], &[]), "no sudo: as root, install ");
    assert_eq!(machine.log(), "");

    let machine = Machine::new("failing");
    machine.manager("apt-get", "exit 100");
    assert_refused(&machine.run(&["cargo", "test"], &[]), "could not install");

    let machine = Machine::new("ineffective");
    machine.manager("apt-get", "");
    assert_refused(&machine.run(&["cargo", "test"], &[]), "still missing");
}

/// A Python whose pip writes a wheel, and which unpacks it to a library; both talk on stdout.
const PYTHON: &str = r#"
    echo "python3 $*" >>"$ROOT/log"; echo chatter
    case "$*" in
        *download*) [[ $(cat "$ROOT"/target/oidn.*/wheel.txt) == "pyoidn=="*" --hash=sha256:"* ]] ;;
        "- "*) cat >/dev/null; : >"$2/lib/libOpenImageDenoise.so.2" ;;
    esac"#;

#[test]
fn tests_get_open_image_denoise_once() {
    let machine = Machine::new("oidn");
    machine.driver(LAVAPIPE);
    machine.stub("python3", PYTHON);
    let library = machine.root.join("target/oidn/lib/libOpenImageDenoise.so.2");
    for calls in [3, 3] {
        let output = machine.run(&["cargo", "test"], &[("OIDN_LIBRARY", "")]);
        assert_ran(&output, "cargo test");
        assert_eq!(machine.variable("OIDN_LIBRARY").as_deref(), library.to_str());
        // Whether there is a pip, the download, and the unpacking: only once.
        assert_eq!(machine.log().lines().count(), calls, "{}", machine.log());
    }
    assert_eq!(fs::read_dir(machine.root.join("target")).unwrap().count(), 1, "something was left behind");
    machine.run(&["cargo", "test"], &[("OIDN_LIBRARY", "mine.so")]);
    assert_eq!(machine.variable("OIDN_LIBRARY").as_deref(), Some("mine.so"));
    machine.run(&["cargo", "run"], &[("OIDN_LIBRARY", "")]);
    assert_eq!(machine.variable("OIDN_LIBRARY").as_deref(), Some(""));

    // The tests that do without it still run.
    let machine = Machine::new("oidn-offline");
    machine.driver(LAVAPIPE);
    machine.stub("python3", "[[ $* != *download* ]]");
    let output = machine.run(&["cargo", "test"], &[("OIDN_LIBRARY", "")]);
    assert_ran(&output, "cargo test");
    assert!(stderr(&output).contains("cannot be fetched"), "{}", stderr(&output));
    assert_eq!(fs::read_dir(machine.root.join("target")).unwrap().count(), 0, "something was left behind");

    let machine = Machine::new("no-pip");
    machine.driver(LAVAPIPE);
    machine.manager("apt-get", r#"mv "$ROOT/bin/not-python3" "$ROOT/bin/python3""#);
    machine.stub("not-python3", PYTHON);
    machine.run(&["cargo", "test"], &[("OIDN_LIBRARY", "")]);
    assert!(machine.log().contains("install -qy --no-install-recommends python3-pip"), "{}", machine.log());
}

#[test]
fn swiftshader_is_unpacked_once_and_is_the_only_driver() {
    let machine = Machine::new("swiftshader");
    machine.driver(LAVAPIPE);
    // The first package of the list has none.
    machine.manager("apt-get", r#": >"$3_1_amd64.deb""#);
    machine.stub("dpkg-deb", r#"[[ $2 == chromium_* ]]"#);
    machine.stub("tar", "cat; : >libvk_swiftshader.so; echo {} >vk_swiftshader_icd.json");
    let manifest = machine.root.join("target/swiftshader/vk_swiftshader_icd.json");
    for _ in 0..2 {
        let output = machine.run(&["--swiftshader", "cargo", "test"], &[("VK_DRIVER_FILES", "/mine.json")]);
        assert_ran(&output, "cargo test");
        assert_eq!(machine.variable("VK_DRIVER_FILES").as_deref(), manifest.to_str());
        assert_eq!(fs::read_dir(manifest.parent().unwrap()).unwrap().count(), 2, "a package is left behind");
        assert!(machine.log().ends_with("apt-get download -q chromium\n"), "{}", machine.log());
        assert_eq!(machine.log().matches("-q chromium\n").count(), 1, "{}", machine.log());
    }

    let machine = Machine::new("no-swiftshader");
    machine.driver(LAVAPIPE);
    assert_refused(&machine.run(&["--no-install", "--swiftshader", "cargo", "test"], &[]), "missing: SwiftShader");
    assert_refused(&machine.run(&["--swiftshader", "cargo", "test"], &[]), "no apt-get");
    machine.manager("apt-get", "exit 100");
    machine.stub("dpkg-deb", "exit 2");
    machine.stub("tar", "exit 2");
    assert_refused(&machine.run(&["--swiftshader", "cargo", "test"], &[]), "have no SwiftShader");
    assert_eq!(fs::read_dir(machine.root.join("target")).unwrap().count(), 0, "something was left behind");
}

#[test]
fn messages_of_the_validation_layer_fail_the_command() {
    let machine = Machine::new("validation");
    machine.driver(LAVAPIPE);
    fs::create_dir_all(machine.root.join("share/vulkan/explicit_layer.d")).unwrap();
    let layer = r#": >"$ROOT/share/vulkan/explicit_layer.d/VkLayer_khronos_validation.json""#;
    machine.manager("apt-get", &format!("[[ $1 == update ]] || {layer}"));
    for _ in 0..2 {
        assert_ran(&machine.run(&["--validation", "cargo", "test"], &[]), "cargo test");
        assert_eq!(machine.log().matches("vulkan-validationlayers").count(), 1, "{}", machine.log());
    }
    assert_eq!(machine.variable("VK_INSTANCE_LAYERS").as_deref(), Some("VK_LAYER_KHRONOS_validation"));
    for (message, code) in [("all is well", 0), ("VUID-vkCmdDispatch-None-02699(ERROR / SPEC): msgNum: 1", 1)] {
        machine.stub("cargo", &format!("echo '{message}'"));
        let output = machine.run(&["--validation", "cargo", "test"], &[]);
        assert_eq!((stdout(&output), output.status.code()), (format!("{message}\n").as_str(), Some(code)));
    }
    assert_eq!(
        fs::read_dir(machine.root.join("tmp")).unwrap().filter(|e| e.as_ref().unwrap().path().is_file()).count(),
        0
    );
}

#[test]
fn builds_for_other_systems_get_their_compiler() {
    let targets = [
        ("x86_64-pc-windows-gnu", "g++-mingw-w64-x86-64", "x86_64-w64-mingw32-g++"),
        ("aarch64-unknown-linux-gnu", "g++-aarch64-linux-gnu", "aarch64-linux-gnu-g++"),
    ];
    for (target, package, compiler) in targets {
        let machine = Machine::new(target);
        machine.driver(LAVAPIPE);
        machine.stub("compiler", "");
        machine.manager("apt-get", &format!(r#"[[ $1 == update ]] || mv "$ROOT/bin/compiler" "$ROOT/bin/{compiler}""#));
        let here = "cargo check --target x86_64-unknown-linux-gnu";
        assert_ran(&machine.run(&here.split(' ').collect::<Vec<_>>(), &[]), here);
        assert_eq!(machine.log(), "");
        let there = format!("cargo check --target {target}");
        for _ in 0..2 {
            assert_ran(&machine.run(&there.split(' ').collect::<Vec<_>>(), &[]), &there);
            assert_eq!(machine.log().matches(package).count(), 1, "{}", machine.log());
        }
    }
}

#[test]
fn mesa_gets_a_private_runtime_folder() {
    let machine = Machine::new("runtime");
    machine.driver(LAVAPIPE);
    machine.run(&["cargo", "test"], &[]);
    let folder = machine.variable("XDG_RUNTIME_DIR").unwrap();
    assert_eq!(fs::metadata(&folder).unwrap().permissions().mode() & 0o777, 0o700);

    // The name is taken by a link, as someone else could have planted it in a shared folder.
    fs::remove_dir(&folder).unwrap();
    symlink("/", &folder).unwrap();
    machine.run(&["cargo", "test"], &[]);
    let other = machine.variable("XDG_RUNTIME_DIR").unwrap();
    assert_ne!(other, folder);
    assert_eq!(fs::metadata(&other).unwrap().permissions().mode() & 0o777, 0o700);

    let mine = machine.root.to_str().unwrap();
    machine.run(&["cargo", "test"], &[("XDG_RUNTIME_DIR", mine)]);
    assert_eq!(machine.variable("XDG_RUNTIME_DIR").as_deref(), Some(mine));
}

#[test]
fn wrong_usage_and_unknown_commands_have_their_own_exit_codes() {
    let machine = Machine::new("usage");
    machine.driver(LAVAPIPE);
    assert_eq!(machine.run(&[], &[]).status.code(), Some(2));
    assert_eq!(machine.run(&["--no-such-option", "cargo"], &[]).status.code(), Some(2));
    assert_eq!(machine.run(&["--help"], &[]).status.code(), Some(0));
    assert_eq!(machine.run(&["no-such-command"], &[]).status.code(), Some(127));
}
