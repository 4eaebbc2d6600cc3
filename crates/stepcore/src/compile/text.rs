//! A list as it is read: one line an operation.

use super::list::List;
use super::needs::Needs;
use super::trace::Layout;
use crate::real::traced::{Arg, Op};

/// What a step computes, in order.
pub(super) fn lines(list: &List, layout: &Layout) -> Vec<String> {
    let needs = Needs::of(list);
    let names = Names { list, needs: &needs, starts: layout.starts() };
    let mut lines = vec![];
    for at in 0..list.nodes.len() {
        if list.cuts.contains(&at) {
            lines.push("the stages solve".into());
        }
        if needs.lives(at) && !matches!(list.nodes[at].op, Op::Input(_)) {
            lines.push(names.line(at));
        }
    }
    let wanted = list.wanted.iter().enumerate();
    let moved = wanted.filter(|(at, (arg, _))| names.number(*arg) != names.place(*at));
    lines.extend(moved.filter_map(|(at, (arg, limit))| {
        // What accelerates, and how many rows there are, follow from the rest.
        let state = at < names.starts[4];
        let within = if limit.is_finite() { format!(", at most {limit:e}") } else { String::new() };
        state.then(|| format!("{} = {}{within}", names.place(at), names.number(*arg)))
    }));
    lines.extend(list.assumed.iter().map(|mask| format!("require not x{mask}")));
    lines
}

struct Names<'a> {
    list: &'a List,
    needs: &'a Needs,
    starts: [usize; 9],
}

impl Names<'_> {
    /// A number of the state.
    fn place(&self, at: usize) -> String {
        let kinds = ["qpos", "qvel", "act", "kept", "qacc", "rows", "ctrl", "input", "handed"];
        let kind = (0..kinds.len()).rev().find(|kind| self.starts[*kind] <= at).unwrap_or(0);
        format!("{}[{}]", kinds[kind], at - self.starts[kind])
    }

    fn number(&self, arg: Arg) -> String {
        match self.needs.choices.of(arg) {
            Arg::Known(value) => format!("{value:?}"),
            Arg::Node(node) => match self.list.nodes[node as usize].op {
                Op::Input(place) => self.place(place as usize),
                _ => format!("x{node}"),
            },
        }
    }

    fn line(&self, at: usize) -> String {
        let node = &self.list.nodes[at];
        let args: Vec<String> = node.args.iter().map(|arg| self.number(*arg)).collect();
        let between = |sign: &str| args.join(&format!(" {sign} "));
        let call = |name: &str| format!("{name}({})", args.join(", "));
        let value = match node.op {
            Op::Add => between("+"),
            Op::Sub => between("-"),
            Op::Mul => between("*"),
            Op::Div => between("/"),
            Op::Lt => between("<"),
            Op::Le => between("<="),
            Op::And => between("and"),
            Op::Or => between("or"),
            Op::Not => format!("not {}", args[0]),
            Op::Neg => format!("-{}", args[0]),
            Op::Select => format!("{} if {} else {}", args[1], args[0], args[2]),
            Op::Enter | Op::EnterMask => format!("{} at first", args[0]),
            Op::Leave | Op::LeaveMask => format!("{} at last", args[0]),
            Op::Put(place) => return format!("{} = {}", self.place(place as usize), args[0]),
            op => call(&format!("{op:?}").to_lowercase()),
        };
        format!("x{at} = {value}")
    }
}
