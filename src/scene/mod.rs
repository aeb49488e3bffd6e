//! What a scene is, and its import from glTF.
//!
//! Import works in f64. The finished scene is recentred and scaled by a power of two, so that its bounding sphere has
//! about unit size ([`Normalisation`]). Positions and lengths are in this normalised space unless a field says
//! otherwise. Radiance keeps the file's units.

mod accessor;
mod added_camera;
mod animation;
mod camera;
mod container;
mod coverage;
mod description;
mod draco;
mod environment;
mod fingerprint;
mod framing;
mod geometry;
mod gltf;
mod image_light;
mod images;
mod immersion;
mod import_options;
mod instance;
mod instances;
mod instancing;
mod json;
mod keyframes;
mod ktx2;
mod lens;
mod light;
mod limits;
mod look_at;
mod material;
mod mesh;
mod meshopt;
pub(crate) mod mip;
mod morph;
mod nearest;
mod node;
pub(crate) mod normalisation;
mod notes;
mod panorama;
mod pointer;
mod procedural;
pub(crate) mod repeats;
mod selection;
mod skin;
mod texture;
mod triangle;
mod variants;

pub use added_camera::{AddedCamera, with_camera};
pub use camera::{Camera, Lens, Projection};
pub use description::Scene;
pub use framing::Framing;
pub use gltf::load_and_list;
pub use import_options::ImportOptions;
pub use instance::{Instance, SharedMesh};
pub use lens::{Focus, Iris, MAX_BLADES};
pub use light::{EmitterTriangle, Light, LightKind};
pub use look_at::{Extent, LookAt};
pub(crate) use material::lobes::sheen;
pub use material::lobes::*;
pub use material::{AlphaMode, Material, Medium};
pub(crate) use material::{TEXTURE_USES, constants as material_constants};
pub use nearest::{Nearest, SurfaceSearch};
pub use normalisation::Normalisation;
pub use panorama::Panorama;
pub use texture::{ColourSpace, Filter, Texture, TextureImage, TextureInfo, Wrap, linear_from_srgb};
pub use triangle::{NO_LIGHT, Triangle, Vertex};
