//! Structs that host and kernels share, compared member by member through naga.

use wgpu::naga;

use crate::{Error, Result, gpu_scene, passes};

use super::compose::Composed;

/// A member of a shared struct: name, byte offset, size in bytes.
pub type Member = (&'static str, usize, usize);

/// A struct that host and kernels share: its WGSL name, its size, its members.
pub struct SharedStruct {
    /// WGSL name, unique over all kernels.
    pub name: &'static str,
    /// `size_of` on the host: the stride of an array of it.
    pub bytes: usize,
    /// Members in order.
    pub members: &'static [Member],
}

/// Declares a `#[repr(C)]` struct that a kernel knows by the same name and members.
#[macro_export]
macro_rules! shared_struct {
    ($(#[$meta:meta])* $vis:vis struct $name:ident { $($(#[$field_meta:meta])* $field_vis:vis $field:ident: $ty:ty),* $(,)? }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        $vis struct $name { $($(#[$field_meta])* $field_vis $field: $ty),* }

        impl $name {
            /// How the struct lies in memory, to be compared with the kernels' own.
            pub const SHARED: $crate::gpu::layout::SharedStruct = $crate::gpu::layout::SharedStruct {
                name: stringify!($name),
                bytes: size_of::<$name>(),
                members: &[$((stringify!($field), std::mem::offset_of!($name, $field), size_of::<$ty>())),*],
            };
        }
    };
}

/// All shared structs.
pub const SHARED: &[&SharedStruct] = &[
    &passes::Point::SHARED,
    &passes::Tile::SHARED,
    &passes::cache::CacheParameters::SHARED,
    &passes::cells::CellParameters::SHARED,
    &passes::cells::CellPoint::SHARED,
    &passes::classify::ClassifyParameters::SHARED,
    &passes::film::FilmParameters::SHARED,
    &passes::flux::FluxParameters::SHARED,
    &passes::gather::GatherParameters::SHARED,
    &passes::grid::RequestedCell::SHARED,
    &passes::grid::GridParameters::SHARED,
    &crate::kernels::GridShape::SHARED,
    &passes::grid::Photon::SHARED,
    &passes::irradiance::IrradianceParameters::SHARED,
    &passes::photons::PhotonParameters::SHARED,
    &passes::path::PathParameters::SHARED,
    &passes::sample_lights::SampleLightsParameters::SHARED,
    &passes::shade::ShadeParameters::SHARED,
    &passes::shadow::ShadowParameters::SHARED,
    &passes::ward::WardParameters::SHARED,
    &passes::zones::ZoneParameters::SHARED,
    &passes::ward::WardState::SHARED,
    &gpu_scene::CameraUniform::SHARED,
];

/// Compares every struct that the kernel keeps in storage, uniform or immediate memory with its host twin.
///
/// # Errors
/// [`Error::Kernel`] naming the struct and the member that differ, or the struct that has no twin.
pub fn check(composed: &Composed) -> Result<()> {
    check_against(composed, SHARED)
}

/// As [`check`], against another list (for tests of kernels that are not shipped).
///
/// # Errors
/// As [`check`].
pub fn check_against(composed: &Composed, shared: &[&SharedStruct]) -> Result<()> {
    let module = &composed.module;
    let mut pending: Vec<_> = module
        .global_variables
        .iter()
        .filter(|(_, v)| {
            use naga::AddressSpace::*;
            matches!(v.space, Storage { .. } | Uniform | Immediate)
        })
        .map(|(_, v)| v.ty)
        .collect();
    while let Some(ty) = pending.pop() {
        match &module.types[ty].inner {
            naga::TypeInner::Array { base, .. } => pending.push(*base),
            naga::TypeInner::Struct { members, span } => {
                let name = module.types[ty].name.as_deref().unwrap_or_default();
                let differs = |what: String| Error::kernel(&composed.kernel, format!("struct {name}: {what}"));
                let twin = shared.iter().find(|s| s.name == name);
                let twin = twin.ok_or_else(|| differs("has no twin on the host".into()))?;
                let found: Vec<(String, usize, usize)> = members
                    .iter()
                    .map(|m| {
                        let bytes = module.types[m.ty].inner.size(module.to_ctx()) as usize;
                        (m.name.clone().unwrap_or_default(), m.offset as usize, bytes)
                    })
                    .collect();
                for (i, member) in found.iter().enumerate() {
                    let host = twin.members.get(i).map(|m| (m.0.to_owned(), m.1, m.2));
                    if host.as_ref() != Some(member) {
                        return Err(differs(format!("member {i} is {member:?} in the kernel, {host:?} on the host")));
                    }
                }
                if twin.members.len() != found.len() || twin.bytes != *span as usize {
                    let host = (twin.members.len(), twin.bytes);
                    return Err(differs(format!(
                        "{} members in {span} bytes in the kernel, {} in {} on the host",
                        found.len(),
                        host.0,
                        host.1
                    )));
                }
            }
            _ => {}
        }
    }
    Ok(())
}
