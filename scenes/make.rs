//! Writes the scenes of this folder: `cargo run --release --example make_scenes`. With the argument `atrium` it writes
//! that scene instead, which is too large for the repository.

mod generator;

fn main() -> std::io::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let files = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => generator::scenes().to_vec(),
        ["atrium"] => generator::atrium(2048).to_vec(),
        _ => panic!("the only argument is `atrium`"),
    };
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    for (name, bytes) in files {
        std::fs::write(folder.join(name), &bytes)?;
        println!("scenes/{name}: {} bytes", bytes.len());
    }
    Ok(())
}
