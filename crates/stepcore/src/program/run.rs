//! Executing a list: each operation for a block of worlds, before the next.

use core::cell::Cell;

use super::order::{Do, Ordered};
use crate::real::{Mask, Real};

/// The registers of a block: C times as many worlds as a number has lanes.
pub(super) struct Space<R: Real, const C: usize> {
    numbers: Vec<[Cell<R>; C]>,
    masks: Vec<[Cell<R::Mask>; C]>,
    known: Vec<R>,
    /// Where the list has been right so far.
    right: [Cell<R::Mask>; C],
}

room!(Space<R, C>: numbers, masks, known, right);

fn all<T: Copy, const C: usize>(value: T) -> [Cell<T>; C] {
    core::array::from_fn(|_| Cell::new(value))
}

impl<R: Real, const C: usize> Space<R, C> {
    pub fn new(list: &Ordered) -> Self {
        let known: Vec<R> = list.known.iter().map(|value| R::of(*value)).collect();
        let numbers: Vec<_> = (0..list.numbers).map(|_| all(R::zero())).collect();
        for (register, place) in &list.fixed {
            numbers[usize::from(*register)].iter().for_each(|x| x.set(known[usize::from(*place)]));
        }
        let none = R::Mask::of(false);
        let masks = (0..list.masks).map(|_| all(none)).collect();
        Self { numbers, masks, known, right: all(none) }
    }

    #[inline(always)]
    pub fn get(&self, at: usize, part: usize) -> R {
        self.numbers[at][part].get()
    }

    #[inline(always)]
    pub fn set(&self, at: usize, part: usize, x: R) {
        self.numbers[at][part].set(x);
    }

    /// A new block: nothing was wrong yet.
    pub fn begin(&self) {
        self.right.iter().for_each(|right| right.set(R::Mask::of(true)));
    }

    /// The list was right in every lane since the block began.
    pub fn was_right(&self) -> bool {
        self.right.iter().all(|right| right.get().all())
    }

    /// The list is right only where |x| is no more than a limit.
    #[inline(always)]
    pub fn require(&self, at: usize, limit: R) {
        for (x, right) in self.numbers[at].iter().zip(&self.right) {
            let x = x.get();
            right.set(right.get().and(x.le(limit)).and((-limit).le(x)));
        }
    }

    /// One step.
    #[inline(always)]
    pub fn step(&self, list: &Ordered, limit: R) {
        for step in &list.steps {
            let [d, a, b, c] = [step.d, step.a, step.b, step.c].map(usize::from);
            let Self { numbers, masks, known, .. } = self;
            macro_rules! one {
                (|$x:ident| $f:expr) => {
                    for (to, x) in numbers[d].iter().zip(&numbers[a]) {
                        let $x = x.get();
                        to.set($f);
                    }
                };
            }
            macro_rules! two {
                ($to:ident: |$x:ident, $y:ident| $f:expr) => {
                    for ((to, x), y) in $to[d].iter().zip(&numbers[a]).zip(&numbers[b]) {
                        let ($x, $y) = (x.get(), y.get());
                        to.set($f);
                    }
                };
            }
            macro_rules! with_known {
                (|$x:ident, $k:ident| $f:expr) => {{
                    let $k = known[b];
                    one!(|$x| $f)
                }};
            }
            macro_rules! truth {
                (|$x:ident, $y:ident| $f:expr) => {
                    for ((to, x), y) in masks[d].iter().zip(&masks[a]).zip(&masks[b]) {
                        let ($x, $y) = (x.get(), y.get());
                        to.set($f);
                    }
                };
            }
            match step.what {
                Do::Add => two!(numbers: |x, y| x + y),
                Do::AddKnown => with_known!(|x, k| x + k),
                Do::Sub => two!(numbers: |x, y| x - y),
                Do::SubFrom => with_known!(|x, k| k - x),
                Do::Mul => two!(numbers: |x, y| x * y),
                Do::MulKnown => with_known!(|x, k| x * k),
                Do::MulAdd => {
                    let more = numbers[b].iter().zip(&numbers[c]);
                    for ((to, x), (y, z)) in numbers[d].iter().zip(&numbers[a]).zip(more) {
                        to.set(z.get() + x.get() * y.get());
                    }
                }
                Do::MulKnownAdd => {
                    let k = known[b];
                    for ((to, x), z) in numbers[d].iter().zip(&numbers[a]).zip(&numbers[c]) {
                        to.set(z.get() + x.get() * k);
                    }
                }
                Do::Div => two!(numbers: |x, y| x / y),
                Do::Neg => one!(|x| -x),
                Do::Sqrt => one!(|x| x.sqrt()),
                Do::Sin => one!(|x| x.sin_cos().0),
                Do::Cos => one!(|x| x.sin_cos().1),
                Do::Atan2 => two!(numbers: |x, y| x.atan2(y)),
                Do::Pow => two!(numbers: |x, y| x.powf(y)),
                Do::Select => {
                    let more = numbers[b].iter().zip(&masks[c]);
                    for ((to, x), (y, mask)) in numbers[d].iter().zip(&numbers[a]).zip(more) {
                        to.set(R::select(mask.get(), x.get(), y.get()));
                    }
                }
                Do::Max => two!(numbers: |x, y| x.max(y)),
                Do::MaxKnown => with_known!(|x, k| x.max(k)),
                Do::Min => two!(numbers: |x, y| x.min(y)),
                Do::MinKnown => with_known!(|x, k| x.min(k)),
                Do::Lt => two!(masks: |x, y| x.lt(y)),
                Do::Le => two!(masks: |x, y| x.le(y)),
                Do::Finite => {
                    for (to, x) in masks[d].iter().zip(&numbers[a]) {
                        to.set(x.get().is_finite());
                    }
                }
                Do::And => truth!(|x, y| x.and(y)),
                Do::Or => truth!(|x, y| x.or(y)),
                Do::Not => {
                    for (to, x) in masks[d].iter().zip(&masks[a]) {
                        to.set(x.get().not());
                    }
                }
                Do::Copy => one!(|x| x),
                Do::Known => {
                    let k = known[b];
                    numbers[d].iter().for_each(|to| to.set(k));
                }
                Do::Within => self.require(a, limit),
                Do::NeverBoth => {
                    let both = masks[a].iter().zip(&masks[b]);
                    for (right, (one, other)) in self.right.iter().zip(both) {
                        right.set(right.get().and(one.get().and(other.get()).not()));
                    }
                }
                Do::Never => {
                    for (right, mask) in self.right.iter().zip(&masks[a]) {
                        right.set(right.get().and(mask.get().not()));
                    }
                }
            }
        }
    }
}
