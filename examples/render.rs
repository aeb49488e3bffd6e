//! Renders a glTF file to an EXR: `cargo run --release --example render -- scenes/box.glb box.exr`.

use penumbra::{Device, DeviceChoice, Image, ImportOptions, Progress, Renderer, Result, Scene, Settings};

/// Renders the file `path` with 16 samples per pixel, and calls `show` after each batch of samples.
fn render(path: &str, mut show: impl FnMut(&Progress)) -> Result<Image> {
    let scene = Scene::load(path, &ImportOptions::default())?;
    let camera = scene.cameras.first().cloned().unwrap_or_else(|| scene.frame_camera());
    let settings = Settings::builder().size(256, 256).spp(16).build()?;
    let device = Device::open(&DeviceChoice::Best)?;
    let mut renderer = Renderer::new(&device, scene, &camera, &settings)?;
    while renderer.samples() < settings.image.spp {
        show(&renderer.render_batch()?);
    }
    renderer.image()
}

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(scene), Some(output)) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: render SCENE OUTPUT.exr");
        std::process::exit(2);
    };
    let image = render(&scene, |progress| {
        println!("{} samples per pixel, {} rays", progress.samples, progress.rays);
    })?;
    image.write_exr(&output)
}
