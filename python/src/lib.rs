//! The Python module `penumbra._penumbra`; the package `python/penumbra` exports it, and its types are in
//! `python/penumbra/_penumbra.pyi`.

mod arrays;
mod device;
mod error;
mod keywords;
mod render;
mod result;
mod scene;

use penumbra::{Aov, Technique};
use pyo3::prelude::*;

#[pymodule]
mod _penumbra {
    #[pymodule_export]
    use super::device::devices;
    #[pymodule_export]
    use super::error::{Error, Interrupted};
    #[pymodule_export]
    use super::render::Progress;
    #[pymodule_export]
    use super::result::{RenderResult, merge, read};
    #[pymodule_export]
    use super::scene::Scene;
    use super::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        let py = module.py();
        for error in [py.get_type::<Error>(), py.get_type::<Interrupted>()] {
            error.setattr("result", py.None())?;
        }
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("TECHNIQUES", Technique::all().map(Technique::name).collect::<Vec<_>>())?;
        module.add("AOVS", Aov::ALL.map(Aov::name))
    }
}
