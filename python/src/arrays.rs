//! The channels of an image as numpy arrays.

use numpy::ndarray::{Array2, Array3};
use numpy::{PyArray2, PyArray3};
use penumbra::Image;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The axes by which three channels are one array.
const AXES: [[&str; 3]; 2] = [["R", "G", "B"], ["X", "Y", "Z"]];

/// Three channels as an array (height, width, 3); `None` if one is missing.
pub fn colour<'py>(py: Python<'py>, image: &Image, names: [&str; 3]) -> Option<Bound<'py, PyArray3<f32>>> {
    let channels = names.map(|name| image.channel(name));
    let [Some(x), Some(y), Some(z)] = channels else { return None };
    let samples = x.iter().zip(y).zip(z).flat_map(|((x, y), z)| [*x, *y, *z]).collect();
    let shape = (image.height as usize, image.width as usize, 3);
    let array = Array3::from_shape_vec(shape, samples).expect("a channel has as many samples as the image has pixels");
    Some(PyArray3::from_owned_array(py, array))
}

/// A channel as an array (height, width); `None` if it is missing.
pub fn plane<'py>(py: Python<'py>, image: &Image, name: &str) -> Option<Bound<'py, PyArray2<f32>>> {
    let samples = image.channel(name)?.to_vec();
    let shape = (image.height as usize, image.width as usize);
    let array = Array2::from_shape_vec(shape, samples).expect("a channel has as many samples as the image has pixels");
    Some(PyArray2::from_owned_array(py, array))
}

/// All channels but those of the picture: arrays (height, width, 3) by the name before `.R` or `.X`, and arrays
/// (height, width) by the whole name.
pub fn layers<'py>(py: Python<'py>, image: &Image) -> PyResult<Bound<'py, PyDict>> {
    let layers = PyDict::new(py);
    for channel in &image.channels {
        let name = channel.name.as_str();
        // Pieces have their sums beside the channels that users request.
        if matches!(name, "R" | "G" | "B" | "A") || name.starts_with("piece.") {
            continue;
        }
        let (layer, axis) = name.rsplit_once('.').unwrap_or(("", name));
        let names = |axes: &[&str; 3]| axes.map(|axis| format!("{layer}.{axis}"));
        let axes = AXES.iter().find(|axes| axes.contains(&axis)).filter(|_| !layer.is_empty());
        let whole = axes.map(names).and_then(|names| colour(py, image, names.each_ref().map(String::as_str)));
        match whole {
            Some(array) if !layers.contains(layer)? => layers.set_item(layer, array)?,
            Some(_) => {}
            None => layers.set_item(name, plane(py, image, name))?,
        }
    }
    Ok(layers)
}
