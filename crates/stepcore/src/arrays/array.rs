//! The list of the arrays that a user holds.

use crate::elements::{Element, Kind};
use crate::model::Model;
use crate::real::Constant;

/// An array that the user may write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Array {
    // Changed by a step.
    Qpos,
    Qvel,
    Act,
    CtrlHistory,
    // Read by a step.
    Ctrl,
    QfrcApplied,
    /// Force, then moment, by body: 6 numbers each.
    XfrcApplied,
    /// 0: an equality is left out.
    EqActive,
    MocapPos,
    MocapQuat,
}

impl Array {
    pub const COUNT: usize = 10;
    pub const ALL: [Self; Self::COUNT] = [
        Self::Qpos,
        Self::Qvel,
        Self::Act,
        Self::CtrlHistory,
        Self::Ctrl,
        Self::QfrcApplied,
        Self::XfrcApplied,
        Self::EqActive,
        Self::MocapPos,
        Self::MocapQuat,
    ];
    /// The number of arrays that a step changes: the first ones.
    pub const CHANGED: usize = 4;

    pub fn name(self) -> &'static str {
        match self {
            Self::Qpos => "qpos",
            Self::Qvel => "qvel",
            Self::Act => "act",
            Self::CtrlHistory => "ctrl_history",
            Self::Ctrl => "ctrl",
            Self::QfrcApplied => "qfrc_applied",
            Self::XfrcApplied => "xfrc_applied",
            Self::EqActive => "eq_active",
            Self::MocapPos => "mocap_pos",
            Self::MocapQuat => "mocap_quat",
        }
    }

    /// The shape for one world.
    pub fn shape<N: Constant>(self, model: &Model<N>) -> Vec<usize> {
        match self {
            Self::Qpos => vec![model.nq],
            Self::Qvel | Self::QfrcApplied => vec![model.nv],
            Self::Act => vec![model.na],
            Self::CtrlHistory => vec![model.nhistory],
            Self::Ctrl => vec![model.actuators.len()],
            Self::XfrcApplied => vec![model.bodies.len(), 6],
            Self::EqActive => vec![model.equalities.len()],
            Self::MocapPos => vec![model.mocaps.len(), 3],
            Self::MocapQuat => vec![model.mocaps.len(), 4],
        }
    }

    /// The name of its length.
    pub fn length(self) -> &'static str {
        match self {
            Self::Qpos => "nq",
            Self::Qvel | Self::QfrcApplied => "nv",
            Self::Act => "na",
            Self::CtrlHistory => "nhistory",
            Self::Ctrl => "nu",
            Self::XfrcApplied => "6 nbody",
            Self::EqActive => "neq",
            Self::MocapPos => "3 nmocap",
            Self::MocapQuat => "4 nmocap",
        }
    }

    /// The numbers at the initial configuration, at rest and without inputs.
    pub fn initial(self, model: &Model) -> Vec<f64> {
        self.initial_in(model, 0)
    }

    /// The same in a lane.
    pub(crate) fn initial_in<N: Constant>(self, model: &Model<N>, lane: usize) -> Vec<f64> {
        match self {
            Self::Qpos => model.qpos0.clone(),
            Self::EqActive => (model.equalities.iter())
                .map(|equality| if equality.active { 1.0 } else { 0.0 })
                .collect(),
            Self::MocapPos => (model.mocaps.iter())
                .flat_map(|body| model.bodies[*body].pos.iter().map(|x| x.lane(lane)))
                .collect(),
            Self::MocapQuat => {
                model.mocaps.iter().flat_map(|body| model.bodies[*body].quat).collect()
            }
            _ => vec![0.0; self.count(model)],
        }
    }

    pub fn count<N: Constant>(self, model: &Model<N>) -> usize {
        self.shape(model).iter().product()
    }

    /// The numbers of every array in one world.
    pub fn counts<N: Constant>(model: &Model<N>) -> [usize; Self::COUNT] {
        Self::ALL.map(|array| array.count(model))
    }

    /// The element to which an entry belongs.
    pub(crate) fn owner<N: Constant>(self, model: &Model<N>, k: usize) -> Element {
        let joint = |index| Element::whole(Kind::Joint, index);
        match self {
            Self::Qpos => joint(model.joints.iter().rposition(|j| j.qpos <= k).unwrap_or(0)),
            Self::Qvel | Self::QfrcApplied => joint(model.dofs[k].joint),
            Self::Act | Self::CtrlHistory => {
                let own = |span: &crate::model::Span| span.range().contains(&k);
                let acts = self == Self::Act;
                let spans = if acts { &model.activations } else { &model.histories };
                Element::whole(Kind::Actuator, spans.iter().position(own).unwrap_or(0))
            }
            Self::Ctrl => Element::whole(Kind::Actuator, k),
            Self::XfrcApplied => Element::whole(Kind::Body, k / 6),
            Self::EqActive => Element::whole(Kind::Equality, k),
            Self::MocapPos => Element::whole(Kind::Body, model.mocaps[k / 3]),
            Self::MocapQuat => Element::whole(Kind::Body, model.mocaps[k / 4]),
        }
    }
}

/// Some of the arrays, by bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArraySet(u16);

impl ArraySet {
    pub const NONE: Self = Self(0);
    pub const ALL: Self = Self((1 << Array::COUNT) - 1);
    /// The arrays that a step changes.
    pub const STATE: Self = Self((1 << Array::CHANGED) - 1);

    pub fn insert(&mut self, array: Array) {
        self.0 |= 1 << array as u16;
    }

    pub fn has(self, array: Array) -> bool {
        self.0 >> array as u16 & 1 == 1
    }

    /// Whether any array is in the other set as well.
    pub fn meets(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    pub fn iter(self) -> impl Iterator<Item = Array> {
        Array::ALL.into_iter().filter(move |array| self.has(*array))
    }
}
