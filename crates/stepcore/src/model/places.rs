//! The bodies and geoms that a step places, and how: `plan/places.rs` defines the types.

use super::{Model, NONE};
use crate::plan::places::{Part, Place, Places, Way};
use crate::real::Constant;
use crate::scene::{GeomType, JointType};

impl<N: Constant> Model<N> {
    /// How a body is placed if its pose is no input.
    #[inline(always)]
    pub(crate) fn way(&self, index: usize) -> Way {
        let body = &self.bodies[index];
        match body.joints.of(&self.joints) {
            [only] if only.kind == JointType::Free => {
                return Way::Free { qpos: only.qpos, dof: only.dof };
            }
            _ if body.tree == NONE => return Way::Jointed,
            _ if !body.turns => return Way::Sliding,
            _ => {}
        }
        match self.trees[body.tree].plane {
            Some(_) => Way::Planar,
            None => Way::Jointed,
        }
    }

    /// The part of a geom's pose that contacts need.
    pub(crate) fn part(&self, index: usize) -> Part {
        let geom = &self.geoms[index];
        let round = geom.kind == GeomType::Sphere && geom.belt.is_none();
        if round || !self.bodies[geom.body].turns {
            Part::Centre
        } else if geom.by_axis && geom.in_plane.is_none() {
            Part::Axis
        } else {
            Part::Whole
        }
    }

    /// Everything that a step places.
    pub(super) fn find_places(&self) -> Places {
        let model = self;
        let trees = || model.trees.iter().enumerate();
        let bodies = trees().filter(|(_, tree)| tree.seen).flat_map(|(tree, own)| {
            own.bodies.range().map(move |index| Place { index, tree, how: model.way(index) })
        });
        let moves = |geom: &usize| {
            let body = &model.bodies[model.geoms[*geom].body];
            model.geoms[*geom].collides && (body.tree != NONE || body.carried)
        };
        let geoms = (0..model.geoms.len()).filter(moves).map(|index| {
            let tree = model.bodies[model.geoms[index].body].tree;
            Place { index, tree, how: model.part(index) }
        });
        Places {
            bodies: bodies.collect(),
            geoms: geoms.collect(),
            weighed: trees().filter(|(_, tree)| !tree.constant).map(|(index, _)| index).collect(),
        }
    }
}
