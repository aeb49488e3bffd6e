//! Resources that are bound to the variables of a kernel, by WGSL name.

use std::collections::BTreeMap;

use crate::buffer::{Buffer, Table};

/// A resource that is bound to a WGSL variable.
#[derive(Clone, Copy)]
pub enum Binding<'a> {
    /// A buffer, or a part of one.
    Buffer(&'a Buffer),
    /// A buffer that is not the kit's.
    Raw(&'a wgpu::Buffer),
    /// A texture.
    Texture(&'a wgpu::TextureView),
}

impl<'a> From<&'a Buffer> for Binding<'a> {
    fn from(buffer: &'a Buffer) -> Self {
        Binding::Buffer(buffer)
    }
}

impl<'a> From<&'a wgpu::Buffer> for Binding<'a> {
    fn from(buffer: &'a wgpu::Buffer) -> Self {
        Binding::Raw(buffer)
    }
}

impl<'a> From<&'a Table> for Binding<'a> {
    fn from(table: &'a Table) -> Self {
        match table {
            Table::Texture(view) => Binding::Texture(view),
            Table::Buffer(buffer) => buffer.into(),
        }
    }
}

impl<'a> From<&'a wgpu::TextureView> for Binding<'a> {
    fn from(view: &'a wgpu::TextureView) -> Self {
        Binding::Texture(view)
    }
}

/// Resources by the names of the WGSL variables they are for.
pub trait Bindings {
    /// The resource bound to the variable `name`, if this set has it.
    fn get(&self, name: &str) -> Option<Binding<'_>>;
}

/// A set of resources put together at run time, for tests and for kernels that are made at run time.
#[derive(Default)]
pub struct Resources<'a>(BTreeMap<&'static str, Binding<'a>>);

impl<'a> Resources<'a> {
    /// An empty set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the binding of `resource` to the variable `name`.
    #[must_use]
    pub fn with(mut self, name: &'static str, resource: impl Into<Binding<'a>>) -> Self {
        self.0.insert(name, resource.into());
        self
    }
}

impl Bindings for Resources<'_> {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        self.0.get(name).copied()
    }
}

impl<const N: usize> Bindings for [&dyn Bindings; N] {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        self.iter().find_map(|set| set.get(name))
    }
}

/// The names of a set that [`bindings!`](crate::bindings) declares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Declared {
    /// Variables that the set always has something for.
    pub required: &'static [&'static str],
    /// Variables that it may have something for.
    pub optional: &'static [&'static str],
}

impl Declared {
    /// Whether the set has a field of this name.
    pub fn has(&self, name: &str) -> bool {
        self.required.contains(&name) || self.optional.contains(&name)
    }
}

/// Declares a set of bindings: a struct whose fields are named as the WGSL variables. Fields are references to a
/// [`Buffer`], a [`Table`] or a texture view; optional ones, `Option<&T>`, are for variables that the kernel has only
/// with some features. The struct has a lifetime, which is left out of its declaration, a constant `DECLARED` for
/// [`Host::own`](crate::Host::own), and a method `find` by which the owner of the resources can itself be [`Bindings`].
///
/// ```
/// use kernel_kit::{Buffer, Table};
/// kernel_kit::bindings! {
///     /// What the kernel `shadow` reads and writes.
///     pub struct ShadowBindings {
///         /// Points to be lit.
///         pub points: &Buffer,
///         /// The BVH.
///         pub bvh_nodes: &Table,
///         /// Classes of the points, where points are audited.
///         pub classes: Option<&Buffer>,
///     }
/// }
/// assert_eq!(ShadowBindings::DECLARED.required, ["points", "bvh_nodes"]);
/// assert_eq!(ShadowBindings::DECLARED.optional, ["classes"]);
/// ```
#[macro_export]
macro_rules! bindings {
    ($(#[$meta:meta])* $vis:vis struct $name:ident { $($fields:tt)* }) => {
        $crate::bindings!(@field [$(#[$meta])* $vis $name] [] [] [] $($fields)*);
    };
    (@field $head:tt [$($all:tt)*] [$($required:ident)*] $optional:tt
        $(#[$meta:meta])* $vis:vis $field:ident: &$ty:ty $(, $($rest:tt)*)?) => {
        $crate::bindings!(@field $head [$($all)* { $(#[$meta])* $vis $field: &'a $ty }]
            [$($required)* $field] $optional $($($rest)*)?);
    };
    (@field $head:tt [$($all:tt)*] $required:tt [$($optional:ident)*]
        $(#[$meta:meta])* $vis:vis $field:ident: Option<&$ty:ty> $(, $($rest:tt)*)?) => {
        $crate::bindings!(@field $head [$($all)* { $(#[$meta])* $vis $field: Option<&'a $ty> }]
            $required [$($optional)* $field] $($($rest)*)?);
    };
    (@field [$(#[$meta:meta])* $vis:vis $name:ident] [$({ $($field:tt)* })*]
        [$($required:ident)*] [$($optional:ident)*]) => {
        $(#[$meta])*
        #[derive(Clone, Copy)]
        $vis struct $name<'a> { $($($field)*),* }

        impl<'a> $name<'a> {
            /// The names of the variables.
            pub const DECLARED: $crate::Declared = $crate::Declared {
                required: &[$(stringify!($required)),*],
                optional: &[$(stringify!($optional)),*],
            };

            /// The resource bound to the variable `name`, with the lifetime of the resources.
            #[allow(dead_code)]
            pub fn find(&self, name: &str) -> Option<$crate::Binding<'a>> {
                $(if name == stringify!($required) { return Some(self.$required.into()); })*
                $(if name == stringify!($optional) { return self.$optional.map(Into::into); })*
                None
            }
        }

        impl $crate::Bindings for $name<'_> {
            fn get(&self, name: &str) -> Option<$crate::Binding<'_>> {
                self.find(name)
            }
        }
    };
}
