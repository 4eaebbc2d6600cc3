//! Places that are far from each other.

/// Chooses places after the first `kept` of `chosen` until all are chosen: each time the one of `count`
/// (at most `ROOM`) that is furthest from the chosen ones, the first of even ones, while its squared
/// distance is more than `least`. `square` gives squared distances. Returns the number chosen.
pub fn spread<const ROOM: usize>(
    count: usize,
    chosen: &mut [usize],
    mut kept: usize,
    least: f64,
    square: impl Fn(usize, usize) -> f64,
) -> usize {
    // From each place to the nearest of the chosen ones.
    let mut nearest = [0.0; ROOM];
    nearest[..count].fill(f64::INFINITY);
    let mut known = 0;
    while kept < chosen.len() {
        let mut best = (least, None);
        for (at, nearest) in nearest[..count].iter_mut().enumerate() {
            for own in &chosen[known..kept] {
                let new = square(*own, at);
                *nearest = if new < *nearest { new } else { *nearest };
            }
            if *nearest > best.0 {
                best = (*nearest, Some(at));
            }
        }
        let Some(next) = best.1 else { break };
        chosen[kept] = next;
        known = kept;
        kept += 1;
    }
    kept
}
