//! The entries of a list, and what is known of a number that is not known.

/// By how much more than rounding bounds are widened.
const SURE: f64 = 1e-6;

/// What an entry does. Masks are all ones or all zeros a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Op {
    /// A number of the state: its place there.
    Input(u32),
    /// A number of the world's model: its column.
    Parameter(u32),
    /// Leaves a number at a place of the state, for who works between two parts of a step.
    Put(u32),
    /// What a loop changes: its value where a turn begins, and after the last one. Reads the value
    /// before the loop, and that at the end of a turn.
    Enter,
    Leave,
    /// The same of a mask.
    EnterMask,
    LeaveMask,
    Add,
    Sub,
    Mul,
    Div,
    Neg,
    Sqrt,
    Sin,
    Cos,
    Atan2,
    Pow,
    /// Of a mask and two numbers.
    Select,
    /// a < b ? b : a, and b < a ? b : a.
    Max,
    Min,
    Lt,
    Le,
    Finite,
    And,
    Or,
    Not,
}

impl Op {
    /// It stands for what a loop changes, where a turn begins.
    pub fn enters(self) -> bool {
        matches!(self, Self::Enter | Self::EnterMask)
    }

    /// The same after the last turn.
    pub fn leaves(self) -> bool {
        matches!(self, Self::Leave | Self::LeaveMask)
    }

    /// It computes a mask.
    pub fn is_mask(self) -> bool {
        matches!(
            self,
            Self::Lt
                | Self::Le
                | Self::Finite
                | Self::And
                | Self::Or
                | Self::Not
                | Self::EnterMask
                | Self::LeaveMask
        )
    }
}

/// What an entry reads: a number, exact in the precision at hand, or another entry.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Arg {
    Known(f64),
    Node(u32),
}

impl Arg {
    /// Of a mask.
    pub fn truth(value: bool) -> Self {
        Self::Known(if value { 1.0 } else { 0.0 })
    }

    pub fn node(self) -> Option<u32> {
        match self {
            Self::Node(node) => Some(node),
            Self::Known(_) => None,
        }
    }

    pub fn key(self) -> (bool, u64) {
        match self {
            Self::Known(value) => (true, value.to_bits()),
            Self::Node(node) => (false, node.into()),
        }
    }
}

/// To the bit.
impl PartialEq for Arg {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

/// An entry: what it does, what it reads (as many as `args` says), and what is known of its number.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    pub op: Op,
    pub args: Vec<Arg>,
    pub facts: Facts,
}

/// The entries so far.
#[derive(Default)]
pub(crate) struct Entries {
    pub nodes: Vec<Node>,
    /// What no finite number exceeds.
    pub largest: f64,
}

impl Entries {
    /// What is known of a number.
    pub fn facts(&self, arg: Arg) -> Facts {
        match arg {
            Arg::Known(value) => Facts::exact(value),
            Arg::Node(node) => self.nodes[node as usize].facts,
        }
    }

    /// The operation of an entry, and what it reads.
    pub fn made(&self, arg: Arg) -> Option<(Op, &[Arg])> {
        let node = &self.nodes[arg.node()? as usize];
        Some((node.op, &node.args))
    }

    /// It is no infinity, and a number.
    pub fn finite(&self, arg: Arg) -> bool {
        let Facts { low, high, .. } = self.facts(arg);
        -self.largest <= low && high <= self.largest
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Facts {
    /// Between which numbers it is, if these are finite; else it may be anything, and no number.
    pub low: f64,
    pub high: f64,
    /// It is 0 or −0.
    pub zero: bool,
    /// It is not −0.
    pub plus: bool,
}

impl Facts {
    pub const NOTHING: Self =
        Self { low: f64::NEG_INFINITY, high: f64::INFINITY, zero: false, plus: false };

    pub fn within(most: f64) -> Self {
        Self { low: -most, high: most, ..Self::NOTHING }
    }

    pub fn exact(value: f64) -> Self {
        if value.is_nan() {
            return Self::NOTHING;
        }
        let negative_zero = value == 0.0 && value.is_sign_negative();
        Self { low: value, high: value, zero: value == 0.0, plus: !negative_zero }
    }

    fn between(bounds: [f64; 2]) -> Self {
        let [low, high] = bounds;
        if low.is_nan() || high.is_nan() {
            return Self::NOTHING;
        }
        let [low, high] = [low - SURE * low.abs(), high + SURE * high.abs()];
        Self { low, high, ..Self::NOTHING }
    }

    /// Between the least and the largest of these.
    fn among(corners: [f64; 4]) -> Self {
        if corners.iter().any(|x| x.is_nan()) {
            return Self::NOTHING;
        }
        let fold = |f: fn(f64, f64) -> f64| corners.into_iter().fold(corners[0], f);
        Self::between([fold(f64::min), fold(f64::max)])
    }

    /// Of what an operation computes.
    pub fn of(list: &Entries, op: Op, args: &[Arg]) -> Self {
        let of = |at: usize| list.facts(args[at]);
        let finite = |at: usize| list.finite(args[at]);
        match op {
            Op::Add | Op::Sub if finite(0) && finite(1) => {
                let (a, b) = (of(0), of(1));
                let bounds = match op {
                    Op::Add => [a.low + b.low, a.high + b.high],
                    _ => [a.low - b.high, a.high - b.low],
                };
                Self {
                    zero: a.zero && b.zero,
                    plus: sum_is_plus(op, a, b),
                    ..Self::between(bounds)
                }
            }
            Op::Add | Op::Sub => Self { plus: sum_is_plus(op, of(0), of(1)), ..Self::NOTHING },
            Op::Mul if finite(0) && finite(1) => {
                let (a, b) = (of(0), of(1));
                if a.zero || b.zero {
                    return Self { low: 0.0, high: 0.0, zero: true, plus: false };
                }
                let corners = [a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high];
                let mut facts = Self::among(corners);
                if args[0] == args[1] {
                    (facts.low, facts.plus) = (0.0, true);
                }
                facts
            }
            Op::Div if finite(0) && finite(1) && (of(1).low > 0.0 || of(1).high < 0.0) => {
                let (a, b) = (of(0), of(1));
                Self::among([a.low / b.low, a.low / b.high, a.high / b.low, a.high / b.high])
            }
            Op::Neg => {
                let Self { low, high, zero, .. } = of(0);
                Self { low: -high, high: -low, zero, plus: false }
            }
            Op::Sqrt if finite(0) && of(0).low >= 0.0 => {
                Self::between([of(0).low.sqrt(), of(0).high.sqrt()])
            }
            Op::Sin | Op::Cos => Self::within(1.0 + SURE),
            Op::Select => either(of(1), of(2)),
            Op::Max | Op::Min if finite(0) && finite(1) => {
                let (a, b) = (of(0), of(1));
                let bounds = match op {
                    Op::Max => [a.low.max(b.low), a.high.max(b.high)],
                    _ => [a.low.min(b.low), a.high.min(b.high)],
                };
                let both = either(a, b);
                Self { low: bounds[0], high: bounds[1], ..both }
            }
            _ => Self::NOTHING,
        }
    }

    /// Where it is known to be above this.
    pub fn above(self, value: f64) -> Self {
        Self { low: self.low.max(value), ..self }
    }
}

/// −0 + −0 and −0 − 0 alone are −0.
fn sum_is_plus(op: Op, a: Facts, b: Facts) -> bool {
    let other_is_no_zero = !(b.low <= 0.0 && b.high >= 0.0);
    a.plus || (op == Op::Add && b.plus) || (op == Op::Sub && other_is_no_zero)
}

fn either(a: Facts, b: Facts) -> Facts {
    Facts {
        low: a.low.min(b.low),
        high: a.high.max(b.high),
        zero: a.zero && b.zero,
        plus: a.plus && b.plus,
    }
}
