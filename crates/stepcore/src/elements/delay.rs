//! Controls that arrive late: what an actuator reads of the samples of its control.
//!
//! MuJoCo documentation, "Delays": each step keeps its control, and the forces of an actuator with a
//! delay read the one of `delay` ago. Samples are counted in steps back from the present one, so the
//! newest is one step old, and a shorter delay reads that; a longer one than there are samples reads
//! the oldest. Between samples stands the earlier one, a line, or a cubic through both whose slopes
//! there are those of the neighbours (Catmull-Rom), and 0 at the ends of the list.

use crate::real::Real;
use crate::scene::Interp;

/// A delay this near to a sample [steps] is that of the sample.
const SAME: f64 = 1e-9;

/// The control of so many steps ago; samples: the newest first, one step old.
pub(super) fn read<R: Real>(samples: &[R], steps: f64, interp: Interp) -> R {
    let at = (steps - 1.0).clamp(0.0, (samples.len() - 1) as f64);
    let near = at.round();
    if (at - near).abs() <= SAME {
        return samples[near as usize];
    }
    // `later` is the sample after that time, and `earlier` the one before.
    let (first, share) = (at.floor() as usize, R::of(at.ceil() - at));
    let (later, earlier) = (samples[first], samples[first + 1]);
    match interp {
        Interp::Hold => earlier,
        Interp::Linear => earlier + share * (later - earlier),
        Interp::Cubic => {
            let slope = |k: usize| match (k.checked_sub(1), samples.get(k + 1)) {
                (Some(after), Some(before)) => R::of(0.5) * (samples[after] - *before),
                _ => R::zero(),
            };
            hermite([earlier, later], [slope(first + 1), slope(first)], share)
        }
    }
}

/// The cubic from 0 to 1 with these values and slopes at both ends.
fn hermite<R: Real>(values: [R; 2], slopes: [R; 2], x: R) -> R {
    let rise = values[1] - values[0];
    let bend = slopes[0] + slopes[1] - rise - rise;
    let curve = rise - slopes[0] - bend;
    values[0] + x * (slopes[0] + x * (curve + x * bend))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// MuJoCo 4.0.0's `mj_readCtrl` of the samples 1, 3, −2, 7, the last one step old.
    #[test]
    fn delays_read_as_mujoco_does() {
        let samples = [7.0, -2.0, 3.0, 1.0];
        for (steps, hold, linear, cubic) in [
            (0.2, 7.0, 7.0, 7.0),
            (1.0, 7.0, 7.0, 7.0),
            (1.25, -2.0, 4.75, 5.6875),
            (1.5, -2.0, 2.5, 2.75),
            (2.0, -2.0, -2.0, -2.0),
            (2.3, 3.0, -0.5, -1.3085),
            (2.5, 3.0, 0.5, 0.0625),
            (3.5, 1.0, 2.0, 2.1875),
            (3.75, 1.0, 1.5, 1.3828125),
            (6.0, 1.0, 1.0, 1.0),
        ] {
            let all = [Interp::Hold, Interp::Linear, Interp::Cubic];
            for (interp, want) in all.into_iter().zip([hold, linear, cubic]) {
                let got: f64 = read(&samples, steps, interp);
                assert!((got - want).abs() < 1e-12, "{steps} {interp:?}: {got} {want}");
            }
        }
    }
}
