//! The content of the scene with its instances in their positions.

use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::description::Scene;
use super::instance::Instance;
use super::limits::MAX_CORNERS;
use super::triangle::Triangle;
use crate::{Error, Result};

impl Scene {
    /// Number of triangles that belong to no shared mesh. They come first.
    pub fn unshared_triangles(&self) -> usize {
        self.shared_meshes.first().map_or(self.triangles.len(), |mesh| mesh.triangles.start)
    }

    /// The positions of the vertices, of each instance its own.
    pub(crate) fn placed_vertices(&self) -> impl ParallelIterator<Item = Vec3> + Clone {
        let unshared = self.shared_meshes.first().map_or(self.vertices.len(), |mesh| mesh.vertices.start);
        let unshared = self.vertices[..unshared].par_iter().map(|vertex| vertex.position);
        unshared.chain(self.instances.par_iter().flat_map_iter(|instance| self.vertices_of(*instance)))
    }

    /// The corners of all triangles for which `is_wanted`, and the vertices of each instance.
    pub(crate) fn placed_corners(
        &self,
        is_wanted: impl Fn(&Triangle) -> bool + Copy + Sync + Send,
    ) -> impl ParallelIterator<Item = Vec3> + Clone {
        let unshared =
            (0..self.unshared_triangles()).into_par_iter().filter(move |index| is_wanted(&self.triangles[*index]));
        let unshared = unshared.flat_map_iter(|index| self.triangle_positions(index));
        unshared.chain(self.instances.par_iter().flat_map_iter(|instance| self.vertices_of(*instance)))
    }

    /// The positions of the vertices of each instance.
    pub(super) fn instance_vertices(&self) -> impl Iterator<Item = Vec3> {
        self.instances.iter().flat_map(|instance| self.vertices_of(*instance))
    }

    fn vertices_of(&self, instance: Instance) -> impl Iterator<Item = Vec3> {
        let vertices = self.shared_meshes[instance.mesh].vertices.clone();
        self.vertices[vertices].iter().map(move |vertex| instance.apply(vertex.position))
    }

    /// The triangles of each instance with their corners' positions.
    pub(crate) fn instance_triangles(&self) -> impl Iterator<Item = (&Triangle, [Vec3; 3])> {
        let of_instance = move |instance: Instance| {
            let triangles = self.shared_meshes[instance.mesh].triangles.clone();
            let place = move |(triangle, corners): (_, [Vec3; 3])| (triangle, corners.map(|p| instance.apply(p)));
            triangles.map(|index| (&self.triangles[index], self.triangle_positions(index))).map(place)
        };
        self.instances.iter().flat_map(move |instance| of_instance(*instance))
    }

    /// Replaces the instances by triangles of their own.
    ///
    /// # Errors
    /// [`Error::Usage`] if there are too many; `purpose` says what needs them.
    pub(crate) fn expand_instances(&mut self, purpose: &str) -> Result<()> {
        let Some(first) = self.shared_meshes.first().cloned() else { return Ok(()) };
        let copied = |instance: &Instance| self.shared_meshes[instance.mesh].triangles.len();
        let triangles = first.triangles.start + self.instances.iter().map(copied).sum::<usize>();
        if triangles > MAX_CORNERS / 3 {
            return Err(Error::Usage(format!(
                "{purpose} needs a copy of the triangles of every instance, {triangles} in all, more than {}: use \
                 another technique",
                MAX_CORNERS / 3
            )));
        }
        let own_vertices = Arc::make_mut(&mut self.vertices);
        let shared_vertices = own_vertices.split_off(first.vertices.start);
        let shared_triangles = self.triangles.split_off(first.triangles.start);
        self.triangles.reserve_exact(triangles - first.triangles.start);
        for instance in std::mem::take(&mut self.instances) {
            let mesh = &self.shared_meshes[instance.mesh];
            let stored = |range: &Range<usize>, base: usize| range.start - base..range.end - base;
            let vertices = &shared_vertices[stored(&mesh.vertices, first.vertices.start)];
            let moved = |vertex: u32| vertex - mesh.vertices.start as u32 + own_vertices.len() as u32;
            for triangle in &shared_triangles[stored(&mesh.triangles, first.triangles.start)] {
                self.triangles.push(Triangle { vertices: triangle.vertices.map(moved), ..*triangle });
            }
            own_vertices.extend(vertices.iter().map(|vertex| instance.apply_to_vertex(vertex)));
        }
        self.shared_meshes.clear();
        Ok(())
    }
}
