//! Groups that machine code steps (`compile/`).

use super::group::Group;
use super::rollout::Part;
use crate::compile::Desk;
use crate::real::Real;
use crate::state::State;

/// The controls of a rollout, from which step on, and where its states go.
pub(super) type Given<'a, 'b> = Option<(&'a mut Part<'b>, usize)>;

/// `n` steps of a group, in which `run(group, from, count)` makes those that the code is not right for;
/// with none to make it looks at the group's energies.
pub(super) fn step_compiled<R: Real>(
    desk: &mut Desk<R>,
    group: &mut Group<R>,
    n: u64,
    mut given: Given,
    mut run: impl FnMut(&mut Group<R>, Given, u64, u64),
) {
    if group.is_special() {
        return run(group, given, 0, n);
    }
    let mut done = 0;
    while done < n {
        let count = group.rest.min(n - done);
        if count > 0 {
            let again = given.as_mut().map(|(part, from)| (&mut **part, *from));
            run(group, again, done, count);
            (done, group.rest) = (done + count, group.rest - count);
            if group.has_failed() {
                // Whoever fails does so in all that was asked for.
                group.begin_again();
                return run(group, given, 0, n);
            }
            continue;
        }
        if group.until_look() == Some(0) {
            run(group, None, done, 0);
        }
        let now = (n - done).min(group.until_look().unwrap_or(n)).max(1);
        let last = done + now == n;
        let made = by_code(desk, group, (now, last), &mut given, done);
        done += made;
        group.missed(made < now, made);
    }
}

/// Up to `n` steps by code, the last of them perhaps that of the call: how many it made.
fn by_code<R: Real>(
    desk: &mut Desk<R>,
    group: &mut Group<R>,
    (n, last): (u64, bool),
    given: &mut Given,
    done: u64,
) -> u64 {
    if !group.enter(desk) {
        return 0;
    }
    let made = match given {
        None => {
            let first = desk.step(n - u64::from(last));
            if first + 1 < n || !last {
                first
            } else {
                group.keep_before(desk, first);
                first + desk.step(1)
            }
        }
        Some((part, from)) => {
            let mut made = 0;
            while made < n {
                let step = *from + (done + made) as usize;
                group.inputs.set_ctrl(|lane, at| part.ctrl(step, lane)[at]);
                if !desk.control(&group.inputs.ctrl) {
                    break;
                }
                if last && made + 1 == n {
                    group.keep_before(desk, made);
                }
                if desk.step(1) == 0 {
                    break;
                }
                made += 1;
                let State { qpos, qvel, act, .. } = &mut group.state;
                desk.leave_moving([qpos, qvel, act]);
                part.record(step, &group.state);
            }
            made
        }
    };
    if made > 0 {
        group.went_by_code(desk, made);
    }
    made
}
