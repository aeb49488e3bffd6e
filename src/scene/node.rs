//! The tree of nodes: world matrices in f64.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::json::Json;
use super::notes::Notes;
use crate::Result;

/// Maximum deviation of the length of a rotation quaternion from 1. Quaternions of normalised bytes deviate by up to
/// 0.008.
pub(super) const UNIT_TOLERANCE: f64 = 0.01;

/// A node of the rendered scene.
pub(super) struct Node<'a> {
    /// Index in the file.
    pub index: usize,
    /// The node in the document.
    pub json: Json<'a>,
    /// Transform from the node's space to world space. It is finite.
    pub world: DAffine3,
    /// False if KHR_node_visibility hides the node or one above it. Import then takes only its camera.
    pub visible: bool,
}

impl Node<'_> {
    /// The node with another transform between it and its mesh.
    pub fn moved(&self, local: DAffine3) -> Self {
        Node { json: self.json.clone(), world: self.world * local, ..*self }
    }
}

/// The nodes of the rendered scene in the order of the file. Adds a note if the file has other scenes.
pub(super) fn of_scene<'a>(root: &Json<'a>, notes: &mut Notes) -> Result<Vec<Node<'a>>> {
    let nodes = root.list("nodes")?;
    let mut children = vec![Vec::new(); nodes.len()];
    let mut parent = vec![None; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        for child in node.list("children")? {
            let index = child.index(nodes.len(), "node")?;
            if let Some(other) = parent[index].replace(i) {
                return Err(child.error(format!("node {index} has two parents, {other} and {i}")));
            }
            children[i].push(index);
        }
    }
    refuse_loops(&nodes, &parent, &children)?;

    let local = nodes.iter().map(local_matrix).collect::<Result<Vec<_>>>()?;
    let shown = nodes.iter().map(is_shown).collect::<Result<Vec<_>>>()?;
    let mut placed: Vec<Option<(DAffine3, bool)>> = vec![None; nodes.len()];
    let mut open: Vec<(usize, DAffine3, bool)> = Vec::new();
    for i in scene_roots(root, &parent, &children, &local, notes)? {
        open.push((i, DAffine3::IDENTITY, true));
    }
    while let Some((i, above, visible)) = open.pop() {
        let (matrix, visible) = (above * local[i], visible && shown[i]);
        if !matrix.is_finite() {
            return Err(nodes[i].error("its world matrix is not finite"));
        }
        placed[i] = Some((matrix, visible));
        open.extend(children[i].iter().map(|&child| (child, matrix, visible)));
    }
    let node = |(index, (json, placed)): (usize, (_, Option<_>))| {
        placed.map(|(world, visible)| Node { index, json, world, visible })
    };
    Ok(nodes.into_iter().zip(placed).enumerate().filter_map(node).collect())
}

/// Whether the node itself is not hidden.
fn is_shown(node: &Json) -> Result<bool> {
    let Some(visibility) = node.extension("KHR_node_visibility")? else { return Ok(true) };
    visibility.get("visible")?.map_or(Ok(true), |visible| visible.boolean())
}

/// Refuses loops. Every node has at most one parent, so a node that no root reaches belongs to a loop or descends from
/// one.
fn refuse_loops(nodes: &[Json], parent: &[Option<usize>], children: &[Vec<usize>]) -> Result<()> {
    let mut reached = vec![false; nodes.len()];
    let mut open: Vec<usize> = (0..nodes.len()).filter(|&i| parent[i].is_none()).collect();
    while let Some(i) = open.pop() {
        reached[i] = true;
        open.extend(&children[i]);
    }
    let Some(mut i) = reached.iter().position(|r| !r) else { return Ok(()) };
    for _ in 0..nodes.len() {
        i = parent[i].unwrap_or(i);
    }
    Err(nodes[i].error("is its own ancestor"))
}

/// The nodes at which the rendered scene starts: those of `scene`, else those of the first scene, else all roots.
fn scene_roots(
    root: &Json,
    parent: &[Option<usize>],
    children: &[Vec<usize>],
    local: &[DAffine3],
    notes: &mut Notes,
) -> Result<Vec<usize>> {
    let scenes = root.list("scenes")?;
    let mut listed = Vec::with_capacity(scenes.len());
    for scene in &scenes {
        let nodes = scene.list("nodes")?;
        listed.push(nodes.iter().map(|node| node.index(parent.len(), "node")).collect::<Result<Vec<_>>>()?);
    }
    let selected = root.get("scene")?.map_or(Ok(0), |scene| scene.index(scenes.len(), "scene"))?;
    if scenes.len() > 1 {
        notes.push(format!("scene {selected} of {} is rendered, the others are not", scenes.len()));
    }
    if scenes.is_empty() {
        return Ok((0..parent.len()).filter(|&i| parent[i].is_none()).collect());
    }
    let mut roots = listed.swap_remove(selected);
    // A node that is listed twice, or below another listed node, would be rendered twice.
    roots.sort_unstable();
    roots.dedup();
    let mut below = vec![false; parent.len()];
    let mut open: Vec<usize> = roots.iter().flat_map(|&i| &children[i]).copied().collect();
    while let Some(i) = open.pop() {
        if !std::mem::replace(&mut below[i], true) {
            open.extend(&children[i]);
        }
    }
    roots.retain(|&i| !below[i]);
    // A listed node with a parent is not legal, but some exporters write it. As in other renderers, the scene starts
    // there.
    let moved = |i: usize| parent[i].filter(|&above| local[above] != DAffine3::IDENTITY);
    if let Some((i, above)) = roots.iter().find_map(|&i| Some((i, moved(i)?))) {
        notes.push(format!(
            "scene {selected} lists node {i}, which is not a root: the transform of its parent, node {above}, is not \
             applied"
        ));
    }
    Ok(roots)
}

/// Largest difference from 0 0 0 1 in the last row of an affine matrix. Exporters that invert matrices in f32 leave
/// some units in the last place of 1, which are 1.2e-7 each.
const LAST_ROW_TOLERANCE: f64 = 1e-5;

/// The affine matrix of a file's 16 numbers, column by column; `None` if its last row is not 0 0 0 1, but for rounding.
pub(super) fn affine(m: [f64; 16]) -> Option<DAffine3> {
    let mut last_row = [m[3], m[7], m[11], m[15]].into_iter().zip([0.0, 0.0, 0.0, 1.0]);
    let is_affine = last_row.all(|(found, wanted)| (found - wanted).abs() < LAST_ROW_TOLERANCE);
    let column = |i: usize| DVec3::new(m[4 * i], m[4 * i + 1], m[4 * i + 2]);
    let matrix3 = DMat3::from_cols(column(0), column(1), column(2));
    is_affine.then(|| DAffine3 { matrix3, translation: column(3) })
}

fn local_matrix(node: &Json) -> Result<DAffine3> {
    let parts = [node.get("translation")?, node.get("rotation")?, node.get("scale")?];
    if let Some(matrix) = node.get("matrix")? {
        if parts.iter().any(Option::is_some) {
            return Err(node.error("has both a matrix and a translation, rotation or scale"));
        }
        return affine(matrix.numbers()?).ok_or_else(|| matrix.error("its last row is not 0 0 0 1"));
    }
    let [translation, rotation, scale] = parts;
    let translation = translation.map_or(Ok([0.0; 3]), |t| t.numbers())?;
    let scale = scale.map_or(Ok([1.0; 3]), |s| s.numbers())?;
    let rotation = match rotation {
        Some(json) => {
            let rotation = DQuat::from_array(json.numbers()?);
            if (rotation.length() - 1.0).abs().partial_cmp(&UNIT_TOLERANCE) != Some(std::cmp::Ordering::Less) {
                return Err(json.error(format!("has length {}, not 1", rotation.length())));
            }
            rotation.normalize()
        }
        None => DQuat::IDENTITY,
    };
    Ok(DAffine3::from_scale_rotation_translation(scale.into(), rotation, translation.into()))
}
