//! Sequences: the frames of an animation, or views all around the scene, one file each.

use std::collections::BTreeSet;
use std::fs;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use penumbra::{Error, Result};

use super::options::positive;

/// Stands for the number of the frame in the names of files.
const PLACEHOLDER: &str = "{frame}";

/// Minimum number of digits of a frame number in file names, as in other programs. It does not depend on the range of
/// frames: a frame has the same name whichever others are rendered with it.
const DIGITS: usize = 4;

/// Maximum number of digits: those of the largest frame number, [`u32::MAX`].
const MAX_DIGITS: usize = 10;

/// Maximum number of views of a turntable. All cameras are made before the first view is rendered. At 24 views a
/// second, a sequence of as many lasts half a day.
const MAX_VIEWS: i64 = 1_000_000;

/// Options of a sequence.
#[derive(clap::Args)]
#[command(next_help_heading = "Sequence")]
pub struct SequenceOptions {
    /// Render the frames A to B, both included: frame N shows the animation at N / fps seconds. {frame} in the name of
    /// each output stands for the number of the frame. Frames whose files exist, are complete and show the same scene
    /// with the same settings are skipped: run an interrupted command again, and it continues where it stopped
    #[arg(
        long,
        value_name = "A..B",
        allow_hyphen_values = true,
        groups = ["moment", "sequence"],
        conflicts_with_all = ["checkpoint", "reference"]
    )]
    frames: Option<Frames>,

    /// Render N views from all around the scene, as on a turntable: the first from the azimuth and elevation of --from,
    /// the others counter-clockwise seen from above, all from the same distance. {frame} in the name of each output
    /// stands for the number of the view, 0 to N - 1; complete views are skipped, as with --frames
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u32).range(1..=MAX_VIEWS),
        group = "sequence",
        conflicts_with_all = ["camera", "look_from", "checkpoint", "reference"]
    )]
    turntable: Option<u32>,

    /// Frames per second
    #[arg(long, value_name = "N", default_value_t = 24.0, value_parser = positive, requires = "frames")]
    fps: f64,

    /// Add the number of the frame to the seed. Without this, all frames use the same random numbers, so that noise
    /// flickers less
    #[arg(long, requires = "sequence")]
    seed_per_frame: bool,
}

/// Frames by number, from the first to the last.
#[derive(Clone, Copy)]
struct Frames {
    first: u32,
    last: u32,
}

impl FromStr for Frames {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let form = || "it must be a range of frames, as in 0..99".to_owned();
        let (first, last) = text.split_once("..").ok_or_else(form)?;
        let number = |text: &str| text.parse::<u32>().map_err(|_| form());
        let (first, last) = (number(first)?, number(last)?);
        if last < first { Err(format!("{last} is before {first}")) } else { Ok(Frames { first, last }) }
    }
}

/// A frame of a sequence.
#[derive(Clone, Copy)]
pub struct Frame {
    pub number: u32,
    /// Seconds from the beginning of the animation; `None` for a view of a turntable.
    pub seconds: Option<f64>,
    /// Offset that is added to the seed.
    pub seed: u32,
}

impl SequenceOptions {
    /// The frames; `None` for a single image.
    pub fn frames(&self) -> Option<impl Iterator<Item = Frame>> {
        Some(self.numbers()?.map(|number| self.frame(number)))
    }

    /// The numbers of the frames.
    fn numbers(&self) -> Option<RangeInclusive<u32>> {
        let views = self.turntable.map(|views| Frames { first: 0, last: views - 1 });
        self.frames.or(views).map(|Frames { first, last }| first..=last)
    }

    fn frame(&self, number: u32) -> Frame {
        let seconds = self.turntable.is_none().then_some(f64::from(number) / self.fps);
        Frame { number, seconds, seed: if self.seed_per_frame { number } else { 0 } }
    }

    /// The first frame.
    pub fn first(&self) -> Option<Frame> {
        self.frames()?.next()
    }

    /// The first frame, and those whose numbers are in one of these names: no other frame can have a file of such a
    /// name. Long sequences have too many frames to compare the names of all.
    pub fn first_and_named(&self, names: &[&PathBuf]) -> Vec<Frame> {
        let Some(numbers) = self.numbers() else { return Vec::new() };
        let mut found = BTreeSet::from([*numbers.start()]);
        for name in names {
            // A file behind a link has another name.
            for name in [Some(name.to_path_buf()), fs::canonicalize(name).ok()].into_iter().flatten() {
                found.extend(numbers_in(&name.to_string_lossy()).filter(|number| numbers.contains(number)));
            }
        }
        found.into_iter().map(|number| self.frame(number)).collect()
    }

    /// The number of views of a turntable.
    pub fn views(&self) -> Option<u32> {
        self.turntable
    }

    /// Checks that the names of a sequence's files contain the placeholder, so that each frame has files of its own,
    /// and that those of a single image do not. No frame of an output may have the file of another output's frame.
    pub fn check_names<'p>(&self, paths: impl Iterator<Item = &'p PathBuf> + Clone) -> Result<()> {
        let is_sequence = self.numbers().is_some();
        let flag = if self.turntable.is_some() { "--turntable" } else { "--frames" };
        for path in paths.clone() {
            let has_placeholder = path.to_string_lossy().contains(PLACEHOLDER);
            let problem = match is_sequence {
                true if !has_placeholder => {
                    format!("{flag} writes many files, so its name must contain {PLACEHOLDER}")
                }
                true if path.to_str().is_none() => {
                    format!("{flag} puts numbers into names of UTF-8 only: name another output")
                }
                false if has_placeholder => {
                    format!("{PLACEHOLDER} stands for the number of a frame: add --frames or --turntable")
                }
                _ => continue,
            };
            return Err(Error::Usage(format!("{}: {problem}", path.display())));
        }
        for (i, one) in paths.clone().enumerate() {
            paths.clone().take(i).try_for_each(|other| self.check_apart(one, other))?;
        }
        Ok(())
    }

    /// Checks that no frames of two outputs have one file. Digits beside the placeholder may do that: `1{frame}` and
    /// `{frame}` have frames 11 and 10011 in one file.
    fn check_apart(&self, one: &Path, other: &Path) -> Result<()> {
        let Some(numbers) = self.numbers().filter(|_| one != other) else { return Ok(()) };
        // The frames of the longer name have the smaller numbers, so that a shared file is found soon.
        let (one, other) = if one.as_os_str().len() < other.as_os_str().len() { (other, one) } else { (one, other) };
        let whole = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let (names, others) = (whole(one), whole(other));
        // Long sequences have too many frames to compare where none can share a file.
        if without_numbers(&names) != without_numbers(&others) {
            return Ok(());
        }
        let others_text = others.to_string_lossy();
        let Some((head, _)) = others_text.split_once(PLACEHOLDER) else { return Ok(()) };
        for frame in numbers.clone().map(|number| self.frame(number)) {
            let file = frame.file(&names);
            let text = file.to_string_lossy();
            let mut found = numbers_at(&text, head.len()).filter(|number| numbers.contains(number));
            if let Some(number) = found.find(|number| self.frame(*number).file(&others) == file) {
                let problem = format!(
                    "{} is the file of frame {} of {} and of frame {number} of {}: name another output",
                    frame.file(one).display(),
                    frame.number,
                    one.display(),
                    other.display()
                );
                return Err(Error::Usage(problem));
            }
        }
        Ok(())
    }
}

impl Frame {
    /// The name of its file. [`SequenceOptions::check_names`] has refused names that are not UTF-8.
    pub fn file(&self, path: &Path) -> PathBuf {
        let number = self.number;
        path.to_string_lossy().replace(PLACEHOLDER, &format!("{number:0DIGITS$}")).into()
    }
}

/// A name without what frames may have in common: digits and placeholders.
fn without_numbers(name: &Path) -> String {
    name.to_string_lossy().replace(PLACEHOLDER, "").replace(|c: char| c.is_ascii_digit(), "")
}

/// All numbers that a name has where a file of a sequence has that of its frame. Other digits may be next to them.
fn numbers_in(name: &str) -> impl Iterator<Item = u32> {
    (0..name.len()).flat_map(|from| numbers_at(name, from))
}

/// Those of them that begin at byte `from`.
fn numbers_at(name: &str, from: usize) -> impl Iterator<Item = u32> {
    (DIGITS..=MAX_DIGITS).filter_map(move |digits| name.get(from..from + digits)?.parse().ok())
}
