//! `penumbra table1`: its output and its page.

use std::fs;

use penumbra::internal::report::table1::TECHNIQUES;

use crate::program::{device, folder, run};

#[test]
fn the_table_has_the_papers_figures_beside_ours() {
    let folder = folder();
    let page = folder.path().join("table1.html");
    // Elsewhere than in the repository: the scenes are in the program.
    let arguments = format!("table1 --device {} --width 16 --spp 1 --quiet --html", device());
    let mut command = crate::program::penumbra(&arguments, &[&page]);
    let answer = crate::program::Answer::of(command.current_dir(folder.path()));
    let text = &answer.assert_done().stdout;
    assert_eq!(answer.stderr, "");
    for figure in ["2100 s", "13,104", "30,325,200", "94.7 %", "16 h", "269,361,500", "1,226,560", "91.0 %"] {
        assert!(text.contains(figure), "{figure}: {text}");
    }
    for technique in TECHNIQUES {
        assert_eq!(text.lines().filter(|line| line.starts_with(technique.name())).count(), 2, "{technique}: {text}");
    }

    let html = fs::read_to_string(&page).unwrap();
    let images = html.split("src=\"data:image/png;base64,").skip(1);
    let decoded = images.map(|rest| {
        use base64::Engine;
        let png = base64::engine::general_purpose::STANDARD.decode(rest.split('"').next().unwrap()).unwrap();
        let file = folder.path().join("image.png");
        fs::write(&file, png).unwrap();
        let image = penumbra::Image::read(&file).unwrap();
        assert!(image.channel("G").unwrap().iter().any(|x| *x > 0.0), "a black picture");
        (image.width, image.height)
    });
    assert_eq!(decoded.collect::<Vec<_>>(), [(16, 16); 8]);
    // The page refers to no other file or address.
    assert!(!html.contains("http") && !html.contains("src=\"/") && !html.contains("<script"));
    for cell in ["13,104", "94.7 %", "visibility-estimate"] {
        assert!(html.contains(cell), "{cell}");
    }
}

#[test]
fn what_is_wrong_is_said_before_anything_is_rendered() {
    let folder = folder();
    let missing = folder.path().join("no-folder/table1.html");
    run("table1 --html", &[&missing]).assert_refused(3, &["no-folder"]);
    run("table1 --device no-such-device", &[]).assert_refused(4, &["no-such-device"]);
}
