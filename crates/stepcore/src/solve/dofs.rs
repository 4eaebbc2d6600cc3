//! Sets of dofs: of lists, of islands, of piles.

use crate::model::MANY_TREES;

/// Collects the dofs in some of these lists, ascending; `place` gets the place of each, and
/// `usize::MAX` for every other of the `nv` dofs.
pub(super) fn distinct<'a>(
    lists: impl Iterator<Item = &'a [usize]>,
    nv: usize,
    dofs: &mut Vec<usize>,
    place: &mut Vec<usize>,
) {
    dofs.clear();
    place.clear();
    place.resize(nv, usize::MAX);
    for k in lists.flatten() {
        if place[*k] == usize::MAX {
            place[*k] = 0;
            dofs.push(*k);
        }
    }
    dofs.sort_unstable();
    for (at, k) in dofs.iter().enumerate() {
        place[*k] = at;
    }
}

/// Returns whether Newton's method treats some of these islands, given by tree, as a pile. It
/// follows from the model alone, so that a lane equals its world.
pub(crate) fn any_heap(islands: &[usize]) -> bool {
    let mut trees = vec![0; islands.len()];
    islands.iter().any(|island| {
        trees[*island] += 1;
        trees[*island] >= MANY_TREES
    })
}
