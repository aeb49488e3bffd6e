//! Structs that host and kernels share, compared member by member through naga.

use wgpu::naga;

use crate::compose::Composed;
use crate::error::{Error, Result};

/// A member of a shared struct: name, offset in bytes, size in bytes.
pub type Member = (&'static str, usize, usize);

/// A struct that host and kernels share: its WGSL name, its size, its members.
#[derive(Debug)]
pub struct SharedStruct {
    /// WGSL name, unique over all kernels that are checked against the same list.
    pub name: &'static str,
    /// `size_of` on the host: the stride of an array of it.
    pub bytes: usize,
    /// Members in order.
    pub members: &'static [Member],
}

/// Declares a `#[repr(C)]` struct that kernels know by the same name and members, and its constant `SHARED`, a
/// [`SharedStruct`] for [`Host::shared`](crate::Host::shared). It is `Pod`, so that it can be uploaded, read back and
/// given as immediates.
///
/// ```
/// kernel_kit::shared_struct! {
///     /// A point with its weight.
///     pub struct Weighted {
///         /// Where it is.
///         pub position: [f32; 3],
///         /// How much it counts.
///         pub weight: f32,
///     }
/// }
/// assert_eq!(Weighted::SHARED.bytes, 16);
/// ```
#[macro_export]
macro_rules! shared_struct {
    ($(#[$meta:meta])* $vis:vis struct $name:ident {
        $($(#[$field_meta:meta])* $field_vis:vis $field:ident: $ty:ty),* $(,)?
    }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, $crate::bytemuck::Pod, $crate::bytemuck::Zeroable)]
        #[bytemuck(crate = "::kernel_kit::bytemuck")]
        $vis struct $name { $($(#[$field_meta])* $field_vis $field: $ty),* }

        impl $name {
            /// How the struct lies in memory, to be compared with the kernels' own.
            pub const SHARED: $crate::SharedStruct = $crate::SharedStruct {
                name: stringify!($name),
                bytes: size_of::<$name>(),
                members: &[$((stringify!($field), std::mem::offset_of!($name, $field), size_of::<$ty>())),*],
            };
        }
    };
}

/// A struct that only kernels read and write, and for which the host makes room: its WGSL name, and its size in bytes.
pub type OpaqueStruct<'a> = (&'a str, usize);

/// Compares every struct that the kernel keeps in storage, uniform or immediate memory with the host struct of the same
/// name in `shared`: number, names, order, offsets and sizes of the members, and the stride. Members that are structs
/// are compared too. Only the sizes of the structs in `opaque` are compared.
///
/// # Errors
/// [`Error::Kernel`] naming the struct and the member that differ, or the struct that the host does not have.
pub fn check_layouts(composed: &Composed, shared: &[&SharedStruct], opaque: &[OpaqueStruct<'_>]) -> Result<()> {
    use naga::AddressSpace::{Immediate, Storage, Uniform};
    let module = &composed.module;
    let in_memory = |space: naga::AddressSpace| matches!(space, Storage { .. } | Uniform | Immediate);
    let variables = module.global_variables.iter().filter(|(_, variable)| in_memory(variable.space));
    let mut pending: Vec<_> = variables.map(|(_, variable)| variable.ty).collect();
    while let Some(ty) = pending.pop() {
        match &module.types[ty].inner {
            naga::TypeInner::Array { base, .. } => pending.push(*base),
            naga::TypeInner::Struct { members, span } => {
                let name = module.types[ty].name.as_deref().unwrap_or_default();
                let wrong = |problem| Error::kernel(&composed.kernel, format!("struct {name}: {problem}"));
                if let Some((_, bytes)) = opaque.iter().find(|(opaque, _)| *opaque == name) {
                    if *bytes != *span as usize {
                        return Err(wrong(format!("{span} bytes in the kernel, {bytes} on the host")));
                    }
                    continue;
                }
                compare_struct(module, name, members, *span as usize, shared).map_err(wrong)?;
                pending.extend(members.iter().map(|member| member.ty));
            }
            _ => {}
        }
    }
    Ok(())
}

fn compare_struct(
    module: &naga::Module,
    name: &str,
    members: &[naga::StructMember],
    span: usize,
    shared: &[&SharedStruct],
) -> std::result::Result<(), String> {
    let twin = shared.iter().find(|s| s.name == name).ok_or("has no twin on the host")?;
    for (i, member) in members.iter().enumerate() {
        let bytes = module.types[member.ty].inner.size(module.to_ctx()) as usize;
        let found = (member.name.as_deref().unwrap_or_default(), member.offset as usize, bytes);
        if twin.members.get(i) != Some(&found) {
            let describe = |(name, offset, bytes): Member| format!("{name} ({bytes} bytes at {offset})");
            let host = twin.members.get(i).map_or("missing".to_owned(), |member| describe(*member));
            let kernel = format!("{} ({bytes} bytes at {})", found.0, found.1);
            return Err(format!("member {i} is {kernel} in the kernel, {host} on the host"));
        }
    }
    if twin.members.len() != members.len() || twin.bytes != span {
        let (count, host, bytes) = (members.len(), twin.members.len(), twin.bytes);
        return Err(format!("{count} members in {span} bytes in the kernel, {host} in {bytes} on the host"));
    }
    Ok(())
}
