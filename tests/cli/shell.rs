//! Completions of shells, and manual pages.

use std::fs;
use std::process::{Command, Stdio};

use crate::program::{folder, run};

#[test]
fn completions_know_commands_flags_and_names() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let answer = run(&format!("completions {shell}"), &[]);
        let script = &answer.assert_done().stdout;
        for word in ["render", "devices", "technique", "shadow-photons", "flux-photons"] {
            assert!(script.contains(word), "{shell}: no {word}");
        }
    }
    assert_eq!(run("completions dos", &[]).code, Some(2));
}

/// Bash reads its completions, and they complete a command, a flag and a value.
#[test]
fn bash_completes_the_command_line() {
    let completions = run("completions bash", &[]).stdout;
    for (line, expected) in [
        ("penumbra rend", "render"),
        ("penumbra render --techn", "--technique"),
        ("penumbra render --technique ward", "ward-adaptive"),
    ] {
        let words: Vec<&str> = line.split(' ').collect();
        let last = words.len() - 1;
        let (word, previous) = (words[last], words[last - 1]);
        let call = format!("COMP_WORDS=({line}) COMP_CWORD={last}\n_penumbra penumbra {word} {previous}");
        let script = format!("{completions}\n{call}\necho \"${{COMPREPLY[@]}}\"");
        let bash = Command::new("bash").args(["-c", &script]).stdin(Stdio::null()).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&bash.stdout).trim(), expected, "{}", String::from_utf8_lossy(&bash.stderr));
    }
}

#[test]
fn every_command_has_a_manual_page() {
    let folder = folder();
    let folder = folder.path();
    run("manual", &[&folder]).assert_done();
    for command in ["penumbra", "penumbra-render", "penumbra-plan", "penumbra-compare", "penumbra-completions"] {
        let page = fs::read_to_string(folder.join(format!("{command}.1"))).unwrap();
        assert!(page.contains(".SH NAME"), "{command}: {page}");
    }
    let page = fs::read_to_string(folder.join("penumbra-render.1")).unwrap();
    assert!(page.contains("Samples per pixel") && page.contains("technique"), "{page}");
    assert!(!folder.join("penumbra-manual.1").exists(), "hidden commands are for packages");
    let missing = run("manual", &[&folder.join("missing")]);
    assert_eq!(missing.code, Some(3));
}
