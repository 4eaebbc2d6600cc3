//! Groups that a list steps (`program/`), side by side.

use super::group::Group;
use crate::program::Blocks;
use crate::real::Real;

/// Steps that are made at a time: where a list is not right, so many are made by the stages.
const PORTION: u64 = 32;

/// `run` of every group by itself.
pub(super) fn each<R: Real>(
    groups: &mut [Group<R>],
    n: u64,
    mut run: impl FnMut(usize, &mut Group<R>, u64),
) {
    groups.iter_mut().enumerate().for_each(|(index, group)| run(index, group, n));
}

/// `n` steps of all groups, in which `run` makes those that the list does not; with none to make it looks
/// at a group's energies.
pub(super) fn step_listed<R: Real>(
    list: &Blocks<R>,
    groups: &mut [Group<R>],
    n: u64,
    mut run: impl FnMut(usize, &mut Group<R>, u64),
) {
    let mut first = 0;
    while first < groups.len() {
        let count = Blocks::<R>::portion(groups.len() - first);
        let block = &mut groups[first..first + count];
        let run = |index, group: &mut Group<R>, n| run(first + index, group, n);
        if !list.serves(count) || block.iter().any(|group| group.is_special()) {
            each(block, n, run);
        } else {
            step_block(list, block, n, run);
        }
        first += count;
    }
}

fn step_block<R: Real>(
    list: &Blocks<R>,
    block: &mut [Group<R>],
    n: u64,
    mut run: impl FnMut(usize, &mut Group<R>, u64),
) {
    let mut left = n;
    while left > 0 {
        let mut now = left.min(PORTION);
        for (index, group) in block.iter_mut().enumerate() {
            if group.until_look() == Some(0) {
                run(index, group, 0);
            }
            now = now.min(group.until_look().unwrap_or(now)).max(1);
        }
        if list.step(now, block) {
            block.iter_mut().for_each(Group::listed);
        } else {
            each(block, now, &mut run);
            // Whoever fails does so in all that was asked for.
            for (index, group) in block.iter_mut().enumerate() {
                if group.has_failed() {
                    group.begin_again();
                    run(index, group, n);
                }
            }
            if block.iter().any(Group::has_failed) {
                let well = block.iter_mut().enumerate().filter(|(_, group)| !group.has_failed());
                return well.for_each(|(index, group)| run(index, group, left - now));
            }
        }
        left -= now;
    }
}
