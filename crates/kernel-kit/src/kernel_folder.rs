//! A folder of composed kernels, for later processes.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::{fs, io, process};

use crate::compose::{Composed, Composer};
use crate::digest::digest;
use crate::error::Result;
use crate::feature::{Feature, Features};

/// Maximum number of files in the folder. A scene needs one to two dozen, of 5 to 60 KB each, so this is enough for
/// some fifty scenes that differ in what they need.
const MAX_FILES: usize = 1024;

/// Identifies the composer: with another version, kernels are composed anew. The manifest has the version of wesl.
const COMPOSED_BY: &str = concat!(include_str!("../Cargo.toml"), include_str!("compose.rs"));

/// A folder in which composed kernels are kept for later processes, which then start sooner: composing takes 2 to 30 ms
/// a kernel. Several processes may use it at the same time.
///
/// A kernel is found again if its name, all modules, the features and the composer's version are the same. A file that
/// is not what was written is composed anew; so is everything where the folder can be neither read nor written. Beyond
/// a number of files the oldest half is removed, and no file of others.
#[derive(Clone, Debug)]
pub(crate) struct KernelFolder {
    path: PathBuf,
    max_files: usize,
}

impl KernelFolder {
    /// The folder of that path, which is made when the first kernel is kept.
    pub fn new(path: impl Into<PathBuf>) -> KernelFolder {
        KernelFolder { path: path.into(), max_files: MAX_FILES }
    }

    /// As [`Composer::compose`], from the folder if the kernel is there. If not, it is kept there.
    ///
    /// # Errors
    /// Those of [`Composer::compose`]; none by the folder.
    pub fn compose<F: Feature>(&self, composer: &Composer, kernel: &str, features: &Features<F>) -> Result<Composed> {
        let key = format!("{:032x}", digest(&[COMPOSED_BY, &format!("{:x}", composer.key(kernel, features))]));
        let file = self.path.join(format!("{key}.wgsl"));
        if let Some(composed) = read(&file, &key).and_then(|wgsl| Composed::new(kernel, wgsl).ok()) {
            return Ok(composed);
        }
        let composed = composer.compose(kernel, features)?;
        // Without the file the next process composes the kernel too.
        let _ = self.write(&file, &key, &composed.wgsl);
        Ok(composed)
    }

    /// Writes a file in one step, as other processes may read it.
    fn write(&self, file: &Path, key: &str, wgsl: &str) -> io::Result<()> {
        static WRITTEN: AtomicU32 = AtomicU32::new(0);
        fs::create_dir_all(&self.path)?;
        let number = WRITTEN.fetch_add(1, Ordering::Relaxed);
        let unfinished = file.with_extension(format!("{}-{number}", process::id()));
        let written = fs::write(&unfinished, format!("{:032x}\n{wgsl}", digest(&[key, wgsl])))
            .and_then(|()| fs::rename(&unfinished, file));
        if written.is_err() {
            let _ = fs::remove_file(&unfinished);
        }
        written.and_then(|()| self.remove_oldest())
    }

    /// Removes the oldest half of the files if there are too many. Those left by a process that was killed count too.
    fn remove_oldest(&self) -> io::Result<()> {
        let files = fs::read_dir(&self.path)?.flatten().filter(|file| is_kept(&file.path()));
        let mut files: Vec<_> =
            files.filter_map(|file| Some((file.metadata().ok()?.modified().ok()?, file.path()))).collect();
        if files.len() > self.max_files {
            files.sort();
            // Another process may have removed some.
            files[..files.len() / 2].iter().for_each(|(_, path)| drop(fs::remove_file(path)));
        }
        Ok(())
    }
}

/// Whether a file has the name of one that the folder keeps, finished or not.
fn is_kept(file: &Path) -> bool {
    let stem = file.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    stem.len() == 32 && stem.chars().all(|c| c.is_ascii_hexdigit())
}

/// The text of a file that is as it was written.
fn read(file: &Path, key: &str) -> Option<String> {
    let mut text = fs::read_to_string(file).ok()?;
    let (written, wgsl) = text.split_once('\n')?;
    let start = text.len() - wgsl.len();
    (written == format!("{:032x}", digest(&[key, wgsl]))).then(|| text.split_off(start))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::NoFeature;

    /// A kernel `twice` that imports a module of a number.
    fn composer(number: u32) -> Composer {
        let twice = "import package::lib::number::NUMBER;
            @group(0) @binding(0) var<storage, read_write> value: u32;
            @compute @workgroup_size(1) fn twice() { value = 2u * NUMBER; }";
        let number = format!("const NUMBER: u32 = {number}u;");
        Composer::new().with_module("twice", twice).with_module("again", twice).with_module("lib/number", number)
    }

    /// A folder of the test's own.
    fn folder(name: &str) -> KernelFolder {
        let path = std::env::temp_dir().join(format!("kernel-kit-{}-{name}", process::id()));
        let _ = fs::remove_dir_all(&path);
        KernelFolder::new(path)
    }

    fn files(folder: &KernelFolder) -> Vec<PathBuf> {
        fs::read_dir(&folder.path).unwrap().map(|file| file.unwrap().path()).collect()
    }

    fn wgsl(folder: &KernelFolder, composer: &Composer, kernel: &str) -> String {
        folder.compose(composer, kernel, &Features::<NoFeature>::none()).unwrap().wgsl
    }

    /// A kernel of the same name, modules and features is read, any other one is composed.
    #[test]
    fn kernels_are_found_again() {
        let folder = folder("again");
        let composed = composer(1).compose("twice", &Features::none()).unwrap().wgsl;
        for _ in 0..2 {
            assert_eq!(wgsl(&folder, &composer(1), "twice"), composed);
            assert_eq!(files(&folder).len(), 1);
        }
        let other = wgsl(&folder, &composer(2), "twice");
        assert!(other != composed && other.contains("2u"), "{other}");
        assert_eq!(wgsl(&folder, &composer(1), "again"), composed);
        assert_eq!(files(&folder).len(), 3);
        fs::remove_dir_all(&folder.path).unwrap();
    }

    /// A kernel in the folder is used as it is, even if its text is another, as long as its digest is right. A file
    /// that is cut, or that holds the text of another kernel, is not used, but written anew.
    #[test]
    fn only_whole_files_are_read() {
        let folder = folder("whole");
        let composed = wgsl(&folder, &composer(1), "twice");
        let file = files(&folder).remove(0);
        let written = fs::read_to_string(&file).unwrap();
        let key = file.file_stem().unwrap().to_str().unwrap();
        let planted = composed.replace("1u", "7u");
        fs::write(&file, format!("{:032x}\n{planted}", digest(&[key, &planted]))).unwrap();
        assert_eq!(wgsl(&folder, &composer(1), "twice"), planted);
        let of_another = format!("{:032x}\n{planted}", digest(&["another", &planted]));
        for damaged in
            ["", "\n", &written[..40], &written[..written.len() - 1], &written.replace("1u", "7u"), &of_another]
        {
            fs::write(&file, damaged).unwrap();
            assert_eq!(wgsl(&folder, &composer(1), "twice"), composed, "{damaged}");
            assert_eq!(fs::read_to_string(&file).unwrap(), written);
        }
        fs::write(&file, [0xff, 0xfe]).unwrap();
        assert_eq!(wgsl(&folder, &composer(1), "twice"), composed);
        fs::remove_dir_all(&folder.path).unwrap();
    }

    /// The folder keeps the newest files, and where it cannot be made kernels are composed as without it.
    #[test]
    fn folders_are_bounded_and_may_fail() {
        let mut folder = folder("bounded");
        folder.max_files = 4;
        fs::create_dir(&folder.path).unwrap();
        fs::write(folder.path.join("notes.wgsl"), "of somebody else").unwrap();
        for number in 0..20 {
            wgsl(&folder, &composer(number), "twice");
            // With that of somebody else.
            assert!((2..=5).contains(&files(&folder).len()), "{number}");
        }
        assert_eq!(fs::read_to_string(folder.path.join("notes.wgsl")).unwrap(), "of somebody else");
        let newest = KernelFolder::new(files(&folder).remove(0));
        assert_eq!(wgsl(&newest, &composer(1), "twice"), composer(1).compose("twice", &Features::none()).unwrap().wgsl);
        assert!(newest.path.is_file());
        assert!(folder.compose(&composer(1), "missing", &Features::none()).is_err());
        fs::remove_dir_all(&folder.path).unwrap();
    }
}
