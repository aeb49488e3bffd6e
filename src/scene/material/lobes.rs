//! The lobes that a material may have, one file each.

mod anisotropy;
pub use anisotropy::Anisotropy;

mod clearcoat;
pub use clearcoat::Clearcoat;

mod diffuse_transmission;
pub use diffuse_transmission::DiffuseTransmission;

mod dispersion;
pub use dispersion::Dispersion;

mod iridescence;
pub use iridescence::Iridescence;

pub(crate) mod sheen;
pub use sheen::Sheen;

mod specular;
pub use specular::Specular;

mod transmission;
pub use transmission::Transmission;

mod volume;
pub use volume::Volume;
