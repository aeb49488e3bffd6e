//! `penumbra stress`: wrong usage. Its measurements are tested through the library, in tests/extremes.

use std::fs;

use penumbra::internal::stress::FAMILIES;

use crate::program::{folder, run};

#[test]
fn what_is_wrong_is_said_before_anything_is_rendered() {
    run("stress scale gravity", &[]).assert_refused(2, &["gravity", "scale", "light-radius"]);
    let folder = folder();
    let file = folder.path().join("a file");
    fs::write(&file, "").unwrap();
    run("stress scale -o", &[&file]).assert_refused(3, &["a file", "not a folder"]);
}

#[test]
fn help_names_every_family_with_its_parameter_and_range() {
    let answer = run("stress --help", &[]);
    let help = answer.assert_done().stdout.split_whitespace().collect::<Vec<_>>().join(" ");
    for family in FAMILIES {
        let entry = format!("{}: {}, ", family.name, family.parameter);
        let range = help.split_once(&entry).unwrap_or_else(|| panic!("{entry} is not in: {help}")).1;
        let mut words = range.split(' ');
        let [from, to] = [0, 1].map(|skip| words.nth(skip).unwrap().parse::<f64>().unwrap());
        let values = || family.series.iter().flat_map(|series| series.values);
        // Written with one digit: 1.5 may be 1.
        assert!(values().all(|x| (0.66 * from..1.5 * to).contains(x)) && from < to, "{}: {from} to {to}", family.name);
    }
}
