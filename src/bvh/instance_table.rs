//! Instances as kernels read them.

/// Texels of an instance, behind those of the triangles.
///
/// | texel | x y z | w |
/// | --- | --- | --- |
/// | 0 to 2 | a row of the matrix from the scene's space to the mesh's | a coordinate of the mesh's origin |
/// | 3 | index of the tree's root, what to add to an index of a stored triangle | unused |
/// | 4 to 6 | a row of the matrix from the mesh's space to the scene's | a coordinate of the mesh's origin |
pub(crate) const INSTANCE_TEXELS: u32 = 7;

/// Where kernels find instances. They give a triangle of instance i the primitive index
/// `unshared + (i << shift) + index within the mesh`. Below `unshared` are the triangles that belong to no shared mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstanceTable {
    /// The first texel of the instances in [`Bvh::triangles`](super::Bvh::triangles).
    pub base: u32,
    /// Number of triangles that belong to no shared mesh.
    pub unshared: u32,
    /// Bits of the index within a mesh.
    pub shift: u32,
}

impl InstanceTable {
    /// The `override`s of the kernels that trace instances.
    pub fn constants(&self) -> [(&'static str, f64); 3] {
        let InstanceTable { base, unshared, shift } = *self;
        [("instance_base", base), ("unshared_count", unshared), ("instance_shift", shift)]
            .map(|(name, n)| (name, f64::from(n)))
    }
}
