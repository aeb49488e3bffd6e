//! Atomic writes: a file is replaced whole or not at all.

use std::fs;
use std::io::Write;
use std::path::Path;

use penumbra::internal::render::film::{Image, View, check_writable, write_atomically};

fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_failing_write_leaves_the_old_file_and_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    fs::write(&path, "old").unwrap();
    let error = write_atomically(&path, |file| {
        file.write_all(&[0; 100_000])?;
        Err("the encoder gave up".into())
    });
    assert_eq!(error.unwrap_err().to_string(), format!("{}: cannot write: the encoder gave up", path.display()));
    assert_eq!(fs::read_to_string(&path).unwrap(), "old");
    assert_eq!(files(folder.path()), ["a.exr"]);

    write_atomically(&path, |file| Ok(file.write_all(b"new")?)).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "new");
    assert_eq!(files(folder.path()), ["a.exr"]);
}

#[test]
fn an_image_that_cannot_be_encoded_leaves_the_old_file() {
    let folder = tempfile::tempdir().unwrap();
    let mut image = Image::new(2, 1);
    image.add_channel("Z", vec![1.0; 2]);
    for name in ["a.exr", "a.png"] {
        let path = folder.path().join(name);
        fs::write(&path, "old").unwrap();
        if name == "a.exr" {
            // Longer than the format allows.
            image.add_channel("x".repeat(256), vec![1.0; 2]);
        }
        let error = image.write(&path, View::Neutral, 0.0).unwrap_err();
        assert_eq!(error.exit_code(), 3, "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
    }
    assert_eq!(files(folder.path()), ["a.exr", "a.png"]);
}

#[test]
fn outputs_are_checked_before_anything_is_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("old.exr"), "old").unwrap();
    fs::create_dir(at("folder.png")).unwrap();

    check_writable(at("new.png")).unwrap();
    check_writable(at("old.exr")).unwrap();
    check_writable(at("NEW.EXR")).unwrap();
    for (name, code) in
        [("image.jpg", 2), ("image", 2), ("folder.png", 3), ("missing/new.png", 3), ("old.exr/new.png", 3)]
    {
        let error = check_writable(at(name)).unwrap_err();
        assert_eq!(error.exit_code(), code, "{error}");
        assert!(error.to_string().contains(name), "{error}");
    }
    assert_eq!(fs::read_to_string(at("old.exr")).unwrap(), "old");
    assert_eq!(files(folder.path()), ["folder.png", "old.exr"]);
}

#[cfg(unix)]
#[test]
fn a_link_stays_and_its_target_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let (target, link) = (folder.path().join("target.exr"), folder.path().join("link.exr"));
    fs::write(&target, "old").unwrap();
    std::os::unix::fs::symlink(&target, &link).unwrap();
    write_atomically(&link, |file| Ok(file.write_all(b"new")?)).unwrap();
    assert_eq!(fs::read_to_string(&target).unwrap(), "new");
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    // The target need not exist.
    fs::remove_file(&target).unwrap();
    for to in [target.as_path(), Path::new("target.exr")] {
        fs::remove_file(&link).unwrap();
        std::os::unix::fs::symlink(to, &link).unwrap();
        write_atomically(&link, |file| Ok(file.write_all(b"made")?)).unwrap();
        assert_eq!(fs::read_to_string(&target).unwrap(), "made");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        fs::remove_file(&target).unwrap();
    }
}

/// A file that another program keeps to itself is replaced as soon as it lets go; until then there is an error, and the
/// old file.
#[cfg(windows)]
#[test]
fn a_file_open_elsewhere_is_waited_for() {
    use std::os::windows::fs::OpenOptionsExt;
    use std::time::Duration;

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    fs::write(&path, "old").unwrap();
    let keep = || fs::OpenOptions::new().read(true).share_mode(0).open(&path).unwrap();
    let replace = || write_atomically(&path, |file| Ok(file.write_all(b"new")?));

    let kept = keep();
    let error = replace().unwrap_err().to_string();
    assert!(error.contains("open in another program"), "{error}");
    drop(kept);
    assert_eq!(fs::read_to_string(&path).unwrap(), "old");
    assert_eq!(files(folder.path()), ["a.exr"]);

    let kept = keep();
    let other = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(200));
        drop(kept);
    });
    replace().unwrap();
    other.join().unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "new");
}
