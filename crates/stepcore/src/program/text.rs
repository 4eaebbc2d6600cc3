//! A list as it is read: one line an operation, on the numbers of the state and on others.

use super::order::{Do, Ordered, Step};
use super::Program;

impl Program {
    /// What a step executes, in order; what the state's numbers are after it stands in their place.
    pub fn lines(&self) -> Vec<String> {
        let (list, [nq, nv]) = (&self.steps(), [&self.trace.qpos, &self.trace.qvel].map(Vec::len));
        let writer = Writer { list, nq, nv, limit: self.limits.qpos };
        list.steps.iter().map(|step| writer.line(step)).collect()
    }
}

/// Of a list for states of so many numbers, and the size up to which it is right.
struct Writer<'a> {
    list: &'a Ordered,
    nq: usize,
    nv: usize,
    limit: f64,
}

impl Writer<'_> {
    fn number(&self, register: u16) -> String {
        let (at, nq, nv) = (usize::from(register), self.nq, self.nv);
        if at < nq {
            return format!("qpos[{at}]");
        }
        if at < nq + nv {
            return format!("qvel[{}]", at - nq);
        }
        let fixed = self.list.fixed.iter().find(|(fixed, _)| *fixed == register);
        fixed.map_or(format!("x{}", at - nq - nv), |(_, known)| self.known(*known))
    }

    fn known(&self, place: u16) -> String {
        format!("{:?}", self.list.known[usize::from(place)])
    }

    fn line(&self, step: &Step) -> String {
        let mask = |register: u16| format!("m{register}");
        let [d, a, b, c] = [step.d, step.a, step.b, step.c];
        let two = |sign: &str| format!("{} {sign} {}", self.number(a), self.number(b));
        let with = |sign: &str| format!("{} {sign} {}", self.number(a), self.known(b));
        let call = |name: &str| format!("{name}({})", self.number(a));
        let call_two = |name: &str| format!("{name}({}, {})", self.number(a), self.number(b));
        let call_with = |name: &str| format!("{name}({}, {})", self.number(a), self.known(b));
        let value = match step.what {
            Do::Add => two("+"),
            Do::AddKnown => with("+"),
            Do::Sub => two("-"),
            Do::SubFrom => format!("{} - {}", self.known(b), self.number(a)),
            Do::Mul => two("*"),
            Do::MulKnown => with("*"),
            Do::MulAdd => format!("{} + {}", self.number(c), two("*")),
            Do::MulKnownAdd => format!("{} + {}", self.number(c), with("*")),
            Do::Div => two("/"),
            Do::Neg => format!("-{}", self.number(a)),
            Do::Sqrt => call("sqrt"),
            Do::Sin => call("sin"),
            Do::Cos => call("cos"),
            Do::Atan2 => call_two("atan2"),
            Do::Pow => call_two("pow"),
            Do::Select => format!("{} if {} else {}", self.number(a), mask(c), self.number(b)),
            Do::Max => call_two("max"),
            Do::MaxKnown => call_with("max"),
            Do::Min => call_two("min"),
            Do::MinKnown => call_with("min"),
            Do::Lt => two("<"),
            Do::Le => two("<="),
            Do::Finite => call("isfinite"),
            Do::And => format!("{} and {}", mask(a), mask(b)),
            Do::Or => format!("{} or {}", mask(a), mask(b)),
            Do::Not => format!("not {}", mask(a)),
            Do::Copy => self.number(a),
            Do::Known => self.known(b),
            Do::Within => return format!("require |{}| <= {:e}", self.number(a), self.limit),
            Do::NeverBoth => return format!("require not ({} and {})", mask(a), mask(b)),
            Do::Never => return format!("require not {}", mask(a)),
        };
        let of_masks =
            matches!(step.what, Do::Lt | Do::Le | Do::Finite | Do::And | Do::Or | Do::Not);
        format!("{} = {value}", if of_masks { mask(d) } else { self.number(d) })
    }
}
