//! Writes the scenes of this folder: `cargo run --release --example make_scenes`.

mod generator;

fn main() -> std::io::Result<()> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    for (name, bytes) in generator::scenes() {
        std::fs::write(folder.join(name), &bytes)?;
        println!("scenes/{name}: {} bytes", bytes.len());
    }
    Ok(())
}
