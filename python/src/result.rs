//! The class `Result`: an image and its statistics.

use std::path::PathBuf;

use penumbra::settings::Denoise;
use penumbra::{Denoiser, Image, Metadata, Pieces, Statistics, View};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyBytes, PyDict};

use crate::arrays;
use crate::device::{Turn, choice, detached, open};
use crate::error::{error, of_library};
use crate::render::check_library;

/// The result of a render, or an image that was read from a file.
#[pyclass(frozen, name = "Result", module = "penumbra")]
pub struct RenderResult {
    rendered: Image,
    samples: u32,
    statistics: Py<PyDict>,
    // Arrays are made when they are wanted, and then stay the same objects.
    image: PyOnceLock<Py<PyAny>>,
    alpha: PyOnceLock<Py<PyAny>>,
    aovs: PyOnceLock<Py<PyDict>>,
}

impl RenderResult {
    /// That of a render.
    pub fn new(py: Python<'_>, image: Image, statistics: &Statistics) -> PyResult<RenderResult> {
        Ok(RenderResult { statistics: dict(py, statistics)?.unbind(), ..RenderResult::of_image(py, image) })
    }

    /// That of a file, of which no statistics are known.
    pub fn of_image(py: Python<'_>, image: Image) -> RenderResult {
        let samples = match image.metadata.get("samplesPerPixel") {
            Some(Metadata::Int(samples)) => u32::try_from(*samples).unwrap_or(0),
            _ => 0,
        };
        RenderResult {
            rendered: image,
            samples,
            statistics: PyDict::new(py).unbind(),
            image: PyOnceLock::new(),
            alpha: PyOnceLock::new(),
            aovs: PyOnceLock::new(),
        }
    }

    /// What a view shows: the denoised image if there is one.
    fn encode(&self, py: Python<'_>, view: &str, exposure: f32) -> PyResult<Vec<u8>> {
        let view = checked(view, exposure)?;
        detached(py, || self.rendered.shown().to_png(view, exposure))?.map_err(of_library)
    }
}

#[pymethods]
impl RenderResult {
    /// The image, scene-linear Rec.709: a float32 array (height, width, 3), rows from the top.
    #[getter]
    fn image(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let make = || match arrays::colour(py, &self.rendered, ["R", "G", "B"]) {
            Some(array) => Ok(array.into_any().unbind()),
            None => Err(error("the result has no image")),
        };
        self.image.get_or_try_init(py, make).map(|array| array.clone_ref(py))
    }

    /// The alpha of the image: a float32 array (height, width).
    #[getter]
    fn alpha(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let make = || match arrays::plane(py, &self.rendered, "A") {
            Some(array) => Ok(array.into_any().unbind()),
            None => Err(error("the result has no alpha")),
        };
        self.alpha.get_or_try_init(py, make).map(|array| array.clone_ref(py))
    }

    /// The other channels by name, float32 arrays (height, width, 3) or (height, width): the AOVs, and with a denoiser
    /// "denoised", "error" and "relative_error".
    #[getter]
    fn aovs(&self, py: Python<'_>) -> PyResult<Py<PyDict>> {
        let make = || arrays::layers(py, &self.rendered).map(Bound::unbind);
        self.aovs.get_or_try_init(py, make).map(|layers| layers.clone_ref(py))
    }

    /// The denoised image, or None.
    #[getter]
    fn denoised<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.aovs(py)?.bind(py).get_item("denoised")
    }

    /// The statistics, as a dict with the keys of `penumbra render --stats`; empty for an image from a file.
    #[getter]
    fn statistics(&self, py: Python<'_>) -> Py<PyDict> {
        self.statistics.clone_ref(py)
    }

    /// Samples per pixel: the mean over the pixels, rounded; 0 for files that do not say.
    #[getter]
    fn samples(&self) -> u32 {
        self.samples
    }

    /// Writes the image: as .exr with all channels, or as .png tone-mapped by a view; a .png shows the denoised image
    /// if there is one.
    #[pyo3(signature = (path, *, view = "neutral", exposure = 0.0))]
    fn save(&self, py: Python<'_>, path: PathBuf, view: &str, exposure: f32) -> PyResult<()> {
        let view = checked(view, exposure)?;
        detached(py, || self.rendered.write_shown(&path, view, exposure))?.map_err(of_library)
    }

    /// A PNG of the image, or of the denoised image if there is one, tone-mapped by a view (neutral, agx, standard or
    /// raw), with `exposure` in stops.
    #[pyo3(signature = (*, view = "neutral", exposure = 0.0))]
    fn png<'py>(&self, py: Python<'py>, view: &str, exposure: f32) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &self.encode(py, view, exposure)?))
    }

    /// What a notebook shows.
    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.png(py, "neutral", 0.0)
    }

    fn __repr__(&self) -> String {
        let Image { width, height, .. } = self.rendered;
        format!("<penumbra.Result: {width} x {height} pixels, {} samples per pixel>", self.samples)
    }
}

/// The view of that name, if the exposure is a number of stops.
fn checked(view: &str, exposure: f32) -> PyResult<View> {
    if !exposure.is_finite() {
        return Err(error(&format!("exposure is {exposure}; it must be finite")));
    }
    view.parse().map_err(of_library)
}

/// A value of the library as a dict, as in its JSON.
pub fn dict<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyDict>> {
    let text = serde_json::to_string(value).map_err(|problem| error(&problem.to_string()))?;
    let value = py.import("json")?.call_method1("loads", (text,))?;
    value.cast_into().map_err(PyErr::from)
}

/// Reads an image file, .exr, .png or .hdr; its colours become scene-linear.
#[pyfunction]
pub fn read(py: Python<'_>, path: PathBuf) -> PyResult<RenderResult> {
    let image = detached(py, || Image::read(path))?.map_err(of_library)?;
    Ok(RenderResult::of_image(py, image))
}

/// Merges pieces, the .exr files of renders with `samples`, in any order. However an image was cut, the result has the
/// bits of a single piece with all samples. Missing samples are an error, unless `partial` is true: then each pixel is
/// the mean of the samples it has. `denoise` removes noise on `device`; the pieces must have been rendered with
/// `denoise` too.
#[pyfunction]
#[pyo3(signature = (pieces, *, partial = false, denoise = None, oidn_library = None, device = None))]
pub fn merge(
    py: Python<'_>,
    pieces: Vec<PathBuf>,
    partial: bool,
    denoise: Option<&str>,
    oidn_library: Option<PathBuf>,
    device: Option<&Bound<'_, PyAny>>,
) -> PyResult<RenderResult> {
    let denoise = denoise.map_or(Ok(Denoise::None), str::parse).map_err(|problem| error(&problem))?;
    check_library(denoise, oidn_library.as_deref())?;
    let device = choice(device)?;
    let merge = || {
        let files = Pieces::open(&pieces)?;
        match files.missing().first() {
            Some(missing) if !partial => {
                let problem = format!(
                    "the image of this piece is incomplete: {missing} are in no piece; partial=True gives it as it is"
                );
                Err(penumbra::Error::input(&pieces[0], "pieces", problem))
            }
            _ if denoise == Denoise::None => files.merge(),
            _ => {
                let denoiser = Denoiser::new(denoise, oidn_library.as_deref())?;
                let shared = open(&device)?;
                let device = Turn::take(&shared, &device)?;
                files.merge_denoised(&device, &denoiser)
            }
        }
    };
    let image = detached(py, merge)?.map_err(of_library)?;
    Ok(RenderResult::of_image(py, image))
}
