use penumbra::{
    Renderer, Settings, Technique,
    gpu::{DeviceChoice, Gpu},
    scene::{ImportOptions, Scene},
};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let t = std::time::Instant::now();
    let scene = Scene::load(a[1].as_ref(), &ImportOptions { default_light: true, ..Default::default() }).unwrap();
    let gpu = Gpu::open(&DeviceChoice::Best).unwrap();
    let camera = scene.cameras.first().cloned().unwrap_or_else(|| scene.frame_camera());
    let size: u32 = a[4].parse().unwrap();
    let settings = Settings {
        technique: a[3].parse::<Technique>().unwrap(),
        width: size,
        height: size,
        spp: a[5].parse().unwrap(),
        ..Default::default()
    };
    println!("open {:?}", t.elapsed());
    let mut r = Renderer::new(&gpu, scene, &camera, &settings).unwrap_or_else(|e| panic!("{e}"));
    println!("ready {:?}", t.elapsed());
    while r.samples() < settings.spp {
        let p = r.render_batch().unwrap_or_else(|e| panic!("{e}"));
        println!("{p:?} {:?}", t.elapsed());
    }
    let image = r.image().unwrap();
    println!("image {:?}", t.elapsed());
    println!("{}", serde_json::to_string_pretty(&r.statistics().unwrap()).unwrap());
    if let Some(reference) = a.get(6) {
        let reference = penumbra::Image::read(std::path::Path::new(reference)).unwrap();
        println!("relmse {}", penumbra::report::metrics::relmse(&image, &reference).unwrap());
        let m = |i: &penumbra::Image, c: &str| {
            i.channel(c).unwrap().iter().map(|v| *v as f64).sum::<f64>() / (i.width * i.height) as f64
        };
        for c in ["R", "G", "B"] {
            println!("{c} {} {}", m(&image, c), m(&reference, c));
        }
    }
    image.write_exr(std::path::Path::new(&a[2])).unwrap();
    image.write_png(std::path::Path::new(&format!("{}.png", a[2])), penumbra::film::View::Neutral, 0.0).unwrap();
}
