//! Skins: meshes that joints deform (glTF 3.7.3).

use std::sync::Arc;

use glam::DAffine3;

use super::accessor::{Accessor, Component};
use super::json::Json;
use super::node::{Node, affine};
use crate::Result;

/// Maximum number of sets of four joints for a vertex. No known exporter writes more than two, and all sets may share
/// their data.
pub(super) const MAX_SETS: usize = 8;

/// Maximum deviation of the sum of a vertex's weights from 1 without a note. Four normalised bytes deviate by up to
/// 0.008.
const SUM_TOLERANCE: f64 = 0.01;

/// A skin of the file.
pub(super) struct Skin<'r, 'a> {
    json: Json<'a>,
    /// Nodes of the file.
    joints: Vec<usize>,
    inverse_bind: Option<(&'r Accessor<'a>, Json<'a>)>,
}

/// Reads the file's skins.
pub(super) fn read<'r, 'a>(root: &Json<'a>, accessors: &'r [Accessor<'a>]) -> Result<Vec<Skin<'r, 'a>>> {
    let nodes = root.list_len("nodes")?;
    root.list("skins")?.into_iter().map(|json| skin(json, nodes, accessors)).collect()
}

fn skin<'r, 'a>(json: Json<'a>, nodes: usize, accessors: &'r [Accessor<'a>]) -> Result<Skin<'r, 'a>> {
    let list = json.require("joints")?;
    let mut joints = Vec::with_capacity(list.len());
    for joint in list.items()? {
        joints.push(joint.index(nodes, "node")?);
    }
    if joints.is_empty() {
        return Err(list.error("must not be empty"));
    }
    if let Some(skeleton) = json.get("skeleton")? {
        skeleton.index(nodes, "node")?;
    }
    let inverse_bind = match json.get("inverseBindMatrices")? {
        None => None,
        Some(index) => {
            let accessor = &accessors[index.index(accessors.len(), "accessor")?];
            if (accessor.width, accessor.component) != (16, Component::F32) {
                return Err(index.error("inverse bind matrices must be float 4 x 4 matrices"));
            }
            if accessor.count < joints.len() {
                let problem = format!("has {} matrices for {} joints", accessor.count, joints.len());
                return Err(index.error(problem));
            }
            Some((accessor, index))
        }
    };
    Ok(Skin { json, joints, inverse_bind })
}

impl Skin<'_, '_> {
    /// Number of joints.
    pub fn joint_count(&self) -> usize {
        self.joints.len()
    }

    /// The matrices from the mesh's own space to world space, by joint. `nodes` are those of the rendered scene, in the
    /// order of the file.
    pub fn matrices(&self, nodes: &[Node]) -> Result<Arc<[DAffine3]>> {
        let inverse_bind = self.inverse_bind()?;
        let matrix = |(i, joint): (usize, &usize)| {
            let node = nodes.binary_search_by_key(joint, |node| node.index);
            let node = node.map_err(|_| self.json.error(format!("joint {i}, node {joint}, is not in the scene")))?;
            Ok(inverse_bind.as_ref().map_or(nodes[node].world, |inverse| nodes[node].world * inverse[i]))
        };
        self.joints.iter().enumerate().map(matrix).collect()
    }

    fn inverse_bind(&self) -> Result<Option<Vec<DAffine3>>> {
        let Some((accessor, json)) = &self.inverse_bind else { return Ok(None) };
        let which: Vec<u32> = (0..self.joints.len() as u32).collect();
        let matrix = |(i, m): (usize, [f32; 16])| {
            if m.iter().any(|x| !x.is_finite()) {
                return Err(json.error(format!("matrix {i} is not finite")));
            }
            let not_affine = || json.error(format!("the last row of matrix {i} is not 0 0 0 1"));
            affine(m.map(f64::from)).ok_or_else(not_affine)
        };
        accessor.floats::<16>(0.0, Some(&which))?.into_iter().enumerate().map(matrix).collect::<Result<_>>().map(Some)
    }
}

/// Joints and weights of four influences on each vertex.
pub(super) struct Set<'a> {
    /// The attribute with the joints.
    pub json: Json<'a>,
    pub joints: Vec<[u16; 4]>,
    pub weights: Vec<[f32; 4]>,
}

impl Set<'_> {
    /// The joint with the highest index among those that have a weight.
    fn highest_joint(&self) -> Option<u16> {
        let pairs = self.joints.as_flattened().iter().zip(self.weights.as_flattened());
        pairs.filter(|(_, weight)| **weight != 0.0).map(|(joint, _)| *joint).max()
    }
}

/// Checks the types of the accessors of a set.
pub(super) fn check_set(joints: (&Json, &Accessor), weights: (&Json, &Accessor)) -> Result<()> {
    let (json, accessor) = joints;
    if !matches!(accessor.component, Component::U8 | Component::U16) || accessor.normalised {
        return Err(json.error("joints must be plain unsigned bytes or shorts"));
    }
    let (json, accessor) = weights;
    let is_share = matches!(accessor.component, Component::U8 | Component::U16) && accessor.normalised;
    if accessor.component != Component::F32 && !is_share {
        return Err(json.error("weights must be floats or normalised unsigned bytes or shorts"));
    }
    Ok(())
}

/// How joints move the vertices of a primitive.
pub(super) struct Influences<'a> {
    sets: Vec<Set<'a>>,
}

impl<'a> Influences<'a> {
    /// The influences of at least one set. The sets have the same number of vertices.
    pub fn new(sets: Vec<Set<'a>>) -> Self {
        Influences { sets }
    }

    /// Whether the weights of some vertex have a sum that is not 1.
    pub fn is_uneven(&self) -> bool {
        let sum = |i: usize| self.sets.iter().flat_map(|set| set.weights[i]).map(f64::from).sum::<f64>();
        (0..self.sets[0].weights.len()).any(|i| (sum(i) - 1.0).abs() > SUM_TOLERANCE)
    }

    /// Refuses joints that the skin of node `node` does not have; it has `joints` of them.
    pub fn check(&self, joints: usize, node: usize) -> Result<()> {
        for set in &self.sets {
            if let Some(joint) = set.highest_joint().filter(|joint| usize::from(*joint) >= joints) {
                let problem = format!("names joint {joint}, but the skin of node {node} has {joints}");
                return Err(set.json.error(problem));
            }
        }
        Ok(())
    }

    /// The matrix of a vertex: the mean of the `matrices` of its joints, by weight; the identity for a vertex without
    /// weights.
    pub fn matrix(&self, vertex: usize, matrices: &[DAffine3]) -> DAffine3 {
        let (mut sum, mut total) = (DAffine3::ZERO, 0.0);
        for set in &self.sets {
            for (joint, weight) in set.joints[vertex].into_iter().zip(set.weights[vertex]) {
                if weight != 0.0 {
                    let (matrix, weight) = (&matrices[usize::from(joint)], f64::from(weight));
                    sum.matrix3 += matrix.matrix3 * weight;
                    sum.translation += matrix.translation * weight;
                    total += weight;
                }
            }
        }
        if total == 0.0 {
            return DAffine3::IDENTITY;
        }
        DAffine3 { matrix3: sum.matrix3 * (1.0 / total), translation: sum.translation / total }
    }
}
