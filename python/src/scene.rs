//! The class `Scene`: a file, as one moment of its animation shows it.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use penumbra::internal::gpu_scene::camera::CameraUniform;
use penumbra::{Camera, Focus, Framing, ImportOptions, Iris, Panorama};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::device::{self, detached, lock};
use crate::error::{error, of_library};
use crate::keywords::{self, take, take_as};
use crate::render::{self, Job, Limits};
use crate::result::RenderResult;

/// A scene of a glTF file.
///
/// A scene does not change: `at` returns the scene at another moment, and `load` reads it with another environment.
#[pyclass(frozen, module = "penumbra")]
pub struct Scene {
    file: File,
    scene: Arc<penumbra::Scene>,
    /// Seconds that it took to read.
    import: f64,
    /// The beginning of the animation, once a camera has framed it. Scenes that `at` makes of each other share it.
    beginning: Arc<Mutex<Option<Arc<penumbra::Scene>>>>,
    /// Whether `at` made the scene. A camera that frames it then frames the beginning of the animation, as in a
    /// sequence, so that all moments have one camera.
    is_moment: bool,
}

/// What a scene was read from.
#[derive(Clone)]
struct File {
    path: PathBuf,
    options: ImportOptions,
    environment: Option<Environment>,
}

#[derive(Clone)]
struct Environment {
    path: PathBuf,
    rotation: f64,
    strength: f32,
}

impl File {
    fn read(&self) -> penumbra::Result<Arc<penumbra::Scene>> {
        let mut scene = penumbra::Scene::load(&self.path, &self.options)?;
        if let Some(Environment { path, rotation, strength }) = &self.environment {
            let (panorama, notes) = Panorama::load(path, self.options.lenient)?;
            scene.set_environment(Arc::new(panorama), *rotation, *strength)?;
            scene.notes.extend(notes);
        }
        Ok(Arc::new(scene))
    }

    /// The same file at another moment.
    fn at(&self, seconds: f64) -> File {
        let mut file = self.clone();
        file.options.time = Some(seconds);
        file
    }
}

#[pymethods]
impl Scene {
    /// Reads a .gltf or .glb file.
    ///
    /// `at` shows an animation this many seconds after its beginning: the first of the file, or `animation` (a name or
    /// an index); with `loop` it begins again after its end. `variant` names a variant of the materials.
    /// `environment` is a panorama around the scene, .exr or .hdr, rotated by `environment_rotation` degrees and
    /// multiplied by `environment_strength`. `default_light` adds a light where the file has none, and `lenient` drops
    /// what is damaged instead of refusing the file.
    #[staticmethod]
    #[pyo3(signature = (path, **keywords), text_signature = "(path, *, at=None, animation=None, loop=False, \
        variant=None, environment=None, environment_rotation=0.0, environment_strength=1.0, default_light=False, \
        lenient=False)")]
    fn load(py: Python<'_>, path: PathBuf, keywords: Option<&Bound<'_, PyDict>>) -> PyResult<Scene> {
        let keywords = keywords.map_or_else(|| Ok(PyDict::new(py)), |given| given.copy())?;
        let options = ImportOptions {
            default_light: take_as(&keywords, "default_light")?.unwrap_or_default(),
            lenient: take_as(&keywords, "lenient")?.unwrap_or_default(),
            animation: take(&keywords, "animation")?.map(|name| name_or_index(&name, "animation")).transpose()?,
            time: take_as(&keywords, "at")?,
            repeat: take_as(&keywords, "loop")?.unwrap_or_default(),
            variant: take_as(&keywords, "variant")?,
            max_copied_triangles: None,
        };
        let (rotation, strength) =
            (take_as(&keywords, "environment_rotation")?, take_as(&keywords, "environment_strength")?);
        let is_turned = rotation.is_some() || strength.is_some();
        let (rotation, strength) = (rotation.unwrap_or(0.0), strength.unwrap_or(1.0));
        let environment = take_as(&keywords, "environment")?.map(|path| Environment { path, rotation, strength });
        keywords::check_empty(&keywords, "Scene.load")?;
        if is_turned && environment.is_none() {
            return Err(error("environment_rotation and environment_strength need environment, a panorama"));
        }
        if options.time.is_none() && (options.animation.is_some() || options.repeat) {
            return Err(error("animation and loop need at, the seconds from the beginning of the animation"));
        }
        let file = File { path, options, environment };
        let start = Instant::now();
        let scene = detached(py, || file.read())?.map_err(of_library)?;
        let import = start.elapsed().as_secs_f64();
        Ok(Scene { file, scene, import, beginning: Arc::default(), is_moment: false })
    }

    /// The scene of the same file, `seconds` after the beginning of its animation.
    ///
    /// If the camera frames the scene, it is the same for all moments: it frames the beginning of the animation.
    #[pyo3(signature = (seconds, *, animation = None), text_signature = "($self, seconds, *, animation=None)")]
    fn at(&self, py: Python<'_>, seconds: f64, animation: Option<&Bound<'_, PyAny>>) -> PyResult<Scene> {
        let mut file = self.file.at(seconds);
        if let Some(animation) = animation {
            file.options.animation = Some(name_or_index(animation, "animation")?);
        }
        let start = Instant::now();
        let is_this = file.options == self.file.options;
        let scene = if is_this { self.scene.clone() } else { detached(py, || file.read())?.map_err(of_library)? };
        let import = start.elapsed().as_secs_f64();
        let is_same = file.options.animation == self.file.options.animation;
        let beginning = if is_same { self.beginning.clone() } else { Arc::default() };
        Ok(Scene { file, scene, import, beginning, is_moment: true })
    }

    /// Renders the scene.
    ///
    /// The keywords are the flags of the program `penumbra render`, and None stands for their defaults: 512 pixels
    /// high, 16 samples per pixel, technique "shadow-photons", seed 0, no denoiser. `samples` makes a piece of the
    /// image for `merge`: the samples from the first number up to, but not including, the second. `progress` is called
    /// with a `Progress` after each batch of samples; if it returns False, the render ends with the samples so far.
    /// Ctrl-C ends the render after the current batch and raises `Interrupted`, a KeyboardInterrupt whose `result` has
    /// the samples so far. Other Python threads run meanwhile.
    #[pyo3(
        signature = (**keywords),
        text_signature = "($self, *, width=None, height=None, spp=None, samples=None, technique=None, \
        seed=None, camera=None, direction=None, aperture=None, focus=None, iris_blades=None, crop=None, aovs=None, \
        background=None, denoise=None, oidn_library=None, sampling=None, noise=None, time=None, progress=None, \
        device=None, light_scale=None, max_bounces=None, flux_photons=None, clamp=None, cache=None, accuracy=None, \
        gather_rays=None, photons=None, nearest=None, shadow_photons_per_ray=None, shadow_samples=None, \
        dilate=None, audit=None, paper_counting=None, fine_cells=None, light_sampling=None, \
        sampled_lights=None, cells=None, cell_rays=None, light_buffer_cells=None, shadow_tolerance=None)"
    )]
    fn render(&self, py: Python<'_>, keywords: Option<&Bound<'_, PyDict>>) -> PyResult<RenderResult> {
        let keywords = keywords.map_or_else(|| Ok(PyDict::new(py)), |given| given.copy())?;
        let has = |name: &str| keywords.get_item(name).map(|value| value.is_some_and(|value| !value.is_none()));
        let [has_width, has_height, has_spp, has_noise] = [has("width")?, has("height")?, has("spp")?, has("noise")?];
        let mut settings = keywords::take_settings(&keywords)?;
        let limits = Limits { seconds: take_as(&keywords, "time")?, is_open: (has("time")? || has_noise) && !has_spp };
        let image = &mut settings.image;
        let framed = match (has_width, has_height) {
            (true, true) => image.width as f32 / image.height as f32,
            _ => 1.0,
        };
        let camera = self.camera(py, &keywords, framed)?;
        let aspect = f64::from(CameraUniform::aspect(&camera));
        let side = |length: f64| (length.round() as u32).max(1);
        match (has_width, has_height) {
            (true, true) => {}
            (true, false) => image.height = side(f64::from(image.width) / aspect),
            (false, _) => image.width = side(f64::from(image.height) * aspect),
        }
        let oidn_library = take_as(&keywords, "oidn_library")?;
        let device = device::choice(take(&keywords, "device")?.as_ref())?;
        let progress = take(&keywords, "progress")?.map(Bound::unbind);
        keywords::check_empty(&keywords, "Scene.render")?;
        let scene = self.scene.clone();
        render::run(py, Job { scene, camera, settings, limits, oidn_library, device, progress, import: self.import })
    }

    /// The names of the scene's cameras, in the order of their indices.
    #[getter]
    fn cameras(&self) -> Vec<&str> {
        self.scene.cameras.iter().map(|camera| camera.name.as_str()).collect()
    }

    /// The names of the scene's lights.
    #[getter]
    fn lights(&self) -> Vec<&str> {
        self.scene.lights.iter().map(|light| light.name.as_str()).collect()
    }

    /// The number of the scene's triangles.
    #[getter]
    fn triangles(&self) -> usize {
        self.scene.triangles.len()
    }

    /// Notes on what of the file is not rendered, one line each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.scene.notes.clone()
    }

    /// The path of the scene's file.
    #[getter]
    fn path(&self) -> PathBuf {
        self.file.path.clone()
    }

    /// The files that the scene's file names: buffers, images, functions of procedural objects. They lie below its
    /// folder. With `lenient` some may be missing.
    #[getter]
    fn files(&self) -> Vec<PathBuf> {
        self.scene.files.clone()
    }

    fn __repr__(&self) -> String {
        let (triangles, lights) = (self.scene.triangles.len(), self.scene.lights.len());
        let noun = if lights == 1 { "light" } else { "lights" };
        format!("<penumbra.Scene {:?}: {triangles} triangles, {lights} {noun}>", self.file.path.display().to_string())
    }
}

impl Scene {
    /// The camera that the keywords select, with its lens. `aspect` is that of an image that no camera decides.
    fn camera(&self, py: Python<'_>, keywords: &Bound<'_, PyDict>, aspect: f32) -> PyResult<Camera> {
        let wanted = take(keywords, "camera")?.map(|name| name_or_index(&name, "camera")).transpose()?;
        let direction: Option<[f32; 2]> = take_as(keywords, "direction")?;
        let frames = direction.is_some() || (wanted.is_none() && self.scene.cameras.is_empty());
        let is_of_beginning = self.is_moment && frames;
        let seen = if is_of_beginning { self.beginning(py)? } else { self.scene.clone() };
        let mut camera = select(&seen, wanted.as_deref(), direction, aspect)?;
        let f_number: Option<f64> = take_as(keywords, "aperture")?;
        let distance: Option<f64> = take_as(keywords, "focus")?;
        let blades: Option<u32> = take_as(keywords, "iris_blades")?;
        match f_number {
            Some(f_number) => {
                let iris = Iris { f_number, blades: blades.unwrap_or(0) };
                let focus = distance.map_or(Focus::Auto, Focus::Distance);
                let refused = |problem| error(&format!("aperture: {problem}"));
                seen.open_iris(&mut camera, iris, focus).map_err(refused)?;
            }
            None if distance.is_some() || blades.is_some() => return Err(error("focus and iris_blades need aperture")),
            None => {}
        }
        // All moments have the camera at one position in the file's space; each has a normalised space of its own.
        Ok(if is_of_beginning { camera.renormalised(&seen.normalisation, &self.scene.normalisation) } else { camera })
    }

    /// The scene at the beginning of the animation.
    fn beginning(&self, py: Python<'_>) -> PyResult<Arc<penumbra::Scene>> {
        let read = || -> penumbra::Result<Arc<penumbra::Scene>> {
            let mut beginning = lock(&self.beginning);
            let scene = match &*beginning {
                Some(scene) => scene.clone(),
                None if self.file.options.time == Some(0.0) => self.scene.clone(),
                None => self.file.at(0.0).read()?,
            };
            Ok(beginning.insert(scene).clone())
        };
        detached(py, read)?.map_err(of_library)
    }
}

/// The camera of the scene that the keywords `camera` and `direction` select, without a lens.
fn select(scene: &penumbra::Scene, wanted: Option<&str>, direction: Option<[f32; 2]>, aspect: f32) -> PyResult<Camera> {
    match (wanted, direction) {
        (Some(_), Some(_)) => Err(error("camera and direction cannot be combined: each of them selects the view")),
        (None, Some([azimuth, elevation])) => match azimuth.is_finite() && elevation.abs() <= 90.0 {
            true => Ok(scene.frame(&Framing { azimuth, elevation, aspect, ..Framing::default() })),
            false => Err(error("direction must be azimuth and elevation in degrees, the elevation from -90 to 90")),
        },
        (None, None) => {
            let frame = || scene.frame(&Framing { aspect, ..Framing::default() });
            Ok(scene.cameras.first().cloned().unwrap_or_else(frame))
        }
        (Some(wanted), None) => scene.camera(wanted).cloned().map_err(of_library),
    }
}

/// A name, or the digits of an index.
fn name_or_index(value: &Bound<'_, PyAny>, keyword: &str) -> PyResult<String> {
    match value.extract::<u32>() {
        Ok(index) => Ok(index.to_string()),
        Err(_) => value.extract().map_err(|_| PyTypeError::new_err(format!("{keyword} must be a name or an index"))),
    }
}
