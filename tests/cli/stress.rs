//! `penumbra stress`: what is refused. What it measures is asked of the library, in tests/extremes.

use std::fs;

use crate::program::{folder, run};

#[test]
fn what_is_wrong_is_said_before_anything_is_rendered() {
    run("stress scale gravity", &[]).assert_refused(2, &["gravity", "scale", "light-radius"]);
    let folder = folder();
    let file = folder.path().join("a file");
    fs::write(&file, "").unwrap();
    run("stress scale -o", &[&file]).assert_refused(3, &["a file"]);
}
