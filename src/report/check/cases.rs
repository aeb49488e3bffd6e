//! The file of cases: scenes, settings, baselines and limits, as TOML.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;
use toml::{Table, Value};

use crate::{Error, Result};

/// Flags that `penumbra check` sets itself, or that make no image which could be compared.
const REFUSED: [&str; 15] = [
    "output",
    "stats",
    "device",
    "quiet",
    "checkpoint",
    "resume",
    "reference",
    "time",
    "frames",
    "fps",
    "seed-per-frame",
    "turntable",
    "samples",
    "view",
    "exposure",
];

/// The cases of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Cases {
    /// The kind of device that the baselines are of, if the file names it.
    pub device: Option<String>,
    /// The folder of the baselines.
    pub baselines: PathBuf,
    /// In the order of the file.
    pub cases: Vec<Case>,
}

/// A picture that is compared with a baseline.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Unique in the file.
    pub name: String,
    /// The scene; `None` if another renderer makes the image.
    pub scene: Option<PathBuf>,
    /// The image that it should be.
    pub baseline: PathBuf,
    /// Flags of `penumbra render`.
    pub flags: Vec<String>,
    /// How far the image may be from the baseline.
    pub limits: Limits,
}

/// How far an image may be from its baseline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Limit of relMSE.
    pub relmse: f64,
    /// Limit of the mean of FLIP.
    pub flip: f64,
    /// Limit of the share of pixels that changed.
    pub changed: f64,
    /// A pixel has changed if a channel of its 8-bit sRGB colour differs by more than this.
    pub step: u8,
    /// Seconds after which a render is ended.
    pub seconds: f64,
}

impl Default for Limits {
    /// Limits for another driver or processor on a device of the same kind. On one machine the bits are the same.
    /// Measured with `scenes/check/CASES.toml`: another Vulkan on the CPU (SwiftShader) has relMSE 4.9e-5 and FLIP
    /// 0.013 against lavapipe in the crowd; another seed has relMSE 0.019 to 0.060 and FLIP 0.061 to 0.079 in box,
    /// crowd and materials. The time is for drivers that hang, not for slow machines: a case of that file takes a few
    /// seconds, of which compiling kernels is most, and hosted services end a run, without a page, after six hours.
    fn default() -> Limits {
        Limits { relmse: 1e-3, flip: 0.03, changed: 0.02, step: 8, seconds: 600.0 }
    }
}

/// Limits where a file has them.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct GivenLimits {
    relmse: Option<f64>,
    flip: Option<f64>,
    changed: Option<f64>,
    step: Option<u8>,
    seconds: Option<f64>,
}

impl GivenLimits {
    fn over(self, limits: Limits) -> Limits {
        Limits {
            relmse: self.relmse.unwrap_or(limits.relmse),
            flip: self.flip.unwrap_or(limits.flip),
            changed: self.changed.unwrap_or(limits.changed),
            step: self.step.unwrap_or(limits.step),
            seconds: self.seconds.unwrap_or(limits.seconds),
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GivenFile {
    device: Option<String>,
    baselines: Option<PathBuf>,
    #[serde(default)]
    render: Table,
    #[serde(default)]
    limits: GivenLimits,
    #[serde(default)]
    case: Vec<GivenCase>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct GivenCase {
    name: String,
    scene: Option<PathBuf>,
    baseline: Option<PathBuf>,
    #[serde(default)]
    render: Table,
    #[serde(default)]
    limits: GivenLimits,
}

impl Cases {
    /// Reads a file. Its paths are relative to its folder.
    ///
    /// # Errors
    /// [`Error::Input`] with the line or the case at fault.
    pub fn read(path: impl AsRef<Path>) -> Result<Cases> {
        let path = path.as_ref();
        let bytes = crate::input::read_file(path).map_err(|problem| Error::input(path, "file", problem))?;
        let text = String::from_utf8(bytes).map_err(|_| Error::input(path, "file", "the file is not UTF-8"))?;
        Cases::parse(&text, path)
    }

    /// [`Cases::read`] of a text; `path` names it in errors.
    ///
    /// # Errors
    /// As [`Cases::read`].
    pub fn parse(text: &str, path: &Path) -> Result<Cases> {
        let file: GivenFile = toml::from_str(text).map_err(|problem| {
            let line = problem.span().map_or(1, |span| 1 + text[..span.start].matches('\n').count());
            // Backticks are for settings, and these are about what the file has.
            Error::input(path, format!("line {line}"), problem.message().replace('`', "\""))
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let baselines = folder.join(file.baselines.unwrap_or_else(|| "baselines".into()));
        let limits = file.limits.over(Limits::default());
        let mut names = BTreeSet::new();
        let mut cases: Vec<Case> = Vec::new();
        for GivenCase { name, scene, baseline, render, limits: own } in file.case {
            let refuse = |problem: String| Error::input(path, format!("case {name}"), problem);
            let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
            if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
                let problem = "a name must consist of letters, digits, '-', '_' and '.', and must not begin with '.'";
                return Err(refuse(problem.into()));
            }
            if !names.insert(name.clone()) {
                return Err(refuse("two cases have this name".into()));
            }
            let mut all = file.render.clone();
            all.extend(render);
            let limits = own.over(limits);
            let is_share = |x: f64| (0.0..=1.0).contains(&x);
            if !(limits.relmse >= 0.0 && is_share(limits.flip) && is_share(limits.changed)) {
                return Err(refuse("limits must be 0 or more; flip and changed must be at most 1".into()));
            }
            if Duration::try_from_secs_f64(limits.seconds).is_err() || limits.seconds == 0.0 {
                return Err(refuse("the limit seconds must be a number above 0, and not infinite".into()));
            }
            let baseline = baselines.join(baseline.unwrap_or_else(|| format!("{name}.exr").into()));
            // Each would replace that of the other.
            if let Some(other) = cases.iter().find(|other| other.baseline == baseline) {
                let file = baseline.display();
                let problem = format!("has the baseline {file}, which case {} has too: each needs its own", other.name);
                return Err(refuse(problem));
            }
            cases.push(Case {
                scene: scene.map(|scene| folder.join(scene)),
                baseline,
                flags: flags(&all).map_err(refuse)?,
                limits,
                name,
            });
        }
        if cases.is_empty() {
            return Err(Error::input(path, "file", "the file has no cases: each begins with [[case]]"));
        }
        Ok(Cases { device: file.device, baselines, cases })
    }

    /// The files in the folder of the baselines that no case uses, sorted.
    pub fn unused(&self) -> Vec<PathBuf> {
        let used: BTreeSet<&PathBuf> = self.cases.iter().map(|case| &case.baseline).collect();
        let entries = std::fs::read_dir(&self.baselines).into_iter().flatten();
        let files = entries.filter_map(std::result::Result::ok).map(|entry| entry.path()).filter(|path| path.is_file());
        let mut unused: Vec<PathBuf> = files.filter(|path| !used.contains(path)).collect();
        unused.sort();
        unused
    }
}

/// The flags that a table of settings stands for: `spp = 8` is `--spp=8`, `no-cache = true` is `--no-cache`.
fn flags(table: &Table) -> std::result::Result<Vec<String>, String> {
    let mut flags = Vec::new();
    for (name, value) in table {
        if REFUSED.contains(&name.as_str()) {
            return Err(format!(
                "render.{name} cannot be set: `penumbra check` sets it, or it makes no image to compare"
            ));
        }
        match value {
            Value::Boolean(true) => flags.push(format!("--{name}")),
            Value::Boolean(false) => {}
            Value::Array(values) => {
                let values: Option<Vec<String>> = values.iter().map(text).collect();
                flags.push(format!(
                    "--{name}={}",
                    values.ok_or(format!("render.{name} is not a list of strings and numbers"))?.join(",")
                ));
            }
            value => {
                let problem = || format!("render.{name} must be a string, a number, a boolean or a list");
                flags.push(format!("--{name}={}", text(value).ok_or_else(problem)?));
            }
        }
    }
    Ok(flags)
}

fn text(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text.clone()),
        Value::Integer(number) => Some(number.to_string()),
        Value::Float(number) => Some(number.to_string()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = r##"
        device = "llvmpipe"
        [render]
        width = 48
        no-cache = true
        [limits]
        flip = 0.5
        [[case]]
        name = "box"
        scene = "../box.glb"
        [case.render]
        no-cache = false
        clamp = 0.5
        crop = [0, 0, 8, 6]
        [[case]]
        name = "sky"
        baseline = "a/sky.png"
        limits = { relmse = 0.0, step = 1, seconds = 1.5 }
    "##;

    #[test]
    fn cases_have_the_settings_of_the_file_and_their_own() {
        let cases = Cases::parse(FILE, Path::new("scenes/check/CASES.toml")).unwrap();
        assert_eq!(cases.device.as_deref(), Some("llvmpipe"));
        let [first, second] = cases.cases.as_slice() else { panic!("{cases:?}") };
        assert_eq!(first.scene.as_deref(), Some(Path::new("scenes/check/../box.glb")));
        assert_eq!(first.baseline, Path::new("scenes/check/baselines/box.exr"));
        assert_eq!(first.flags, ["--clamp=0.5", "--crop=0,0,8,6", "--width=48"]);
        assert_eq!(first.limits, Limits { flip: 0.5, ..Limits::default() });
        assert_eq!(second.baseline, Path::new("scenes/check/baselines/a/sky.png"));
        assert_eq!(second.flags, ["--no-cache", "--width=48"]);
        assert_eq!(second.limits, Limits { relmse: 0.0, flip: 0.5, step: 1, seconds: 1.5, ..Limits::default() });
    }

    #[test]
    fn mistakes_are_named() {
        for (text, expected) in [
            ("", "CASES.toml: the file has no cases"),
            ("width = 3\n", "CASES.toml: line 1: unknown field \"width\""),
            ("\n[[case]]\nscene = 1\n", "CASES.toml: line 3: invalid type: integer"),
            ("\nfoo = 1\n", "CASES.toml: line 2: unknown field \"foo\""),
            ("[[case]]\nname = \"a/b\"", "case a/b: a name must consist of letters"),
            ("[[case]]\nname = \"a\"\n[[case]]\nname = \"a\"", "case a: two cases have this name"),
            (
                "[[case]]\nname = \"a\"\n[[case]]\nname = \"b\"\nbaseline = \"a.exr\"",
                "case b: has the baseline baselines/a.exr, which case a has too",
            ),
            ("[[case]]\nname = \"a\"\nrender = { output = \"b\" }", "case a: render.output cannot be set"),
            ("[[case]]\nname = \"a\"\nrender = { crop = [[1]] }", "case a: render.crop is not a list"),
            ("[[case]]\nname = \"a\"\nlimits = { flip = 2.0 }", "case a: limits must be 0 or more"),
            ("[[case]]\nname = \"a\"\nlimits = { relmse = nan }", "case a: limits must be 0 or more"),
            (
                "[[case]]\nname = \"a\"\nlimits = { seconds = 0.0 }",
                "case a: the limit seconds must be a number above 0",
            ),
            (
                "[[case]]\nname = \"a\"\nlimits = { seconds = inf }",
                "case a: the limit seconds must be a number above 0",
            ),
        ] {
            let error = Cases::parse(text, Path::new("CASES.toml")).unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }
}
