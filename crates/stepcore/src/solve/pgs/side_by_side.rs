//! Pyramids of a pile side by side: four contacts that share no body are updated at once, number by
//! number.
//!
//! A contact joins the first four with room behind all earlier contacts of its bodies. Updates of
//! contacts that share no body are independent, so that this equals the sweep over the rows in
//! order, to the last bit; but an update is a chain of dependent additions, and four of them take
//! hardly longer than one.

use super::super::free_bodies::SIX;
use super::super::rows::{Rows, NARROW};
use super::packed::Packed;
use super::point::{along, gain, Each, Numbers, Point, Swept, EDGES, SIDE};
use super::sweep_momentum::{Found, Six, Step, SweepMomentum};
use crate::real::Real;

/// The number of contacts that shows whether they form a chain, each on the one before; a smaller
/// island is not worth packing.
pub(super) const SEEN: usize = 24;
/// An empty place in a four.
const NOBODY: u32 = u32::MAX;

/// Four contacts; unused places are zero.
#[repr(align(64))]
struct Four<R> {
    point: Point<Each<R>>,
    inv_d: [[Each<R>; SIX]; 2],
    /// Into `SideBySide::bodies`.
    bodies: [[u32; SIDE]; 2],
    /// The first row of each.
    rows: [u32; SIDE],
}

/// Momentum's data of four contacts: A + C, impulses at the start of the sweep, and the move before.
#[repr(align(64))]
struct Moved<R> {
    s: [Each<R>; EDGES],
    from: [Each<R>; EDGES],
    last: [Each<R>; EDGES],
}

/// An island of pyramids.
pub(super) struct SideBySide<R> {
    fours: Vec<Four<R>>,
    /// Per four, if sweeps are measured.
    moved: Vec<Moved<R>>,
    /// The first represents everything that no contact moves.
    bodies: Vec<Six<R>>,
    /// The first dof of each.
    dofs: Vec<u32>,
    /// Per body: the next four in which it may be. Per four: the number of contacts up to now.
    free: Vec<u32>,
    filled: Vec<u8>,
    /// Per contact: its bodies and its four.
    places: Vec<([u32; 2], u32)>,
    /// Per dof: the body that starts there, if it is in the island.
    body_at: Vec<u32>,
    /// Momentum, if there is any, and its step before the next sweep.
    momentum: SweepMomentum<R>,
    step: Option<Step<R>>,
    found: Found<R>,
}

room!(SideBySide<R>: fours, moved, bodies, dofs, free, filled, places, body_at, momentum, step,
    found);

impl<R: Real> SideBySide<R> {
    pub fn new() -> Self {
        Self {
            fours: Vec::new(),
            moved: Vec::new(),
            bodies: Vec::new(),
            dofs: Vec::new(),
            free: Vec::new(),
            filled: Vec::new(),
            places: Vec::new(),
            body_at: Vec::new(),
            momentum: SweepMomentum::new(),
            step: None,
            found: Found::nothing(),
        }
    }

    /// Loads an island, with the first row of each of its contacts, and their bodies' u. Load
    /// nothing and returns false if too few of them would be side by side.
    pub fn take<'a>(
        &mut self,
        inv_d: &[R],
        u: &[R],
        contacts: impl Iterator<Item = (u32, &'a Packed<R>)> + Clone,
    ) -> bool {
        if !self.arrange(u.len(), contacts.clone().map(|(_, packed)| packed)) {
            return false;
        }
        self.bodies.clear();
        self.bodies.resize(self.dofs.len(), Six::zero());
        self.load(u);
        self.fours.clear();
        self.fours.extend(self.filled.iter().map(|_| Four::empty()));
        self.filled.fill(0);
        for ((row, packed), (bodies, at)) in contacts.zip(&self.places) {
            let lane = &mut self.filled[*at as usize];
            self.fours[*at as usize].set(usize::from(*lane), row, *bodies, packed, inv_d);
            *lane += 1;
        }
        self.step = None;
        self.moved.clear();
        true
    }

    /// Measures the sweeps of this island; `on`: with momentum.
    pub fn measure(&mut self, inv_d: &[R], on: bool) {
        let by_body = self.dofs.iter().map(|dof| match inv_d.get(*dof as usize..) {
            Some(own) => Six(crate::real::array::from_fn(|k| R::one() / own[k])),
            None => Six::zero(),
        });
        self.step = on.then(|| self.momentum.begin(&self.bodies, by_body));
        self.moved.extend(self.fours.iter().map(|four| Moved {
            s: four.point.inv_s.map(|each| Each(each.0.map(R::recip_or_zero))),
            from: four.point.impulse,
            last: [Each::every(0.0); EDGES],
        }));
    }

    /// After a sweep: start the next one at momentum's point.
    pub fn go_on(&mut self) {
        if self.step.is_some() {
            self.step = Some(self.momentum.step(&mut self.bodies, self.found));
        }
    }

    /// Finds each contact's four; returns false if most would be half empty.
    fn arrange<'a>(&mut self, nv: usize, contacts: impl Iterator<Item = &'a Packed<R>>) -> bool {
        self.body_at.resize(nv, 0);
        self.dofs.clear();
        self.free.clear();
        self.filled.clear();
        self.places.clear();
        self.dofs.push(NOBODY);
        self.free.push(0);
        // All fours before it are full.
        let mut open = 0;
        for packed in contacts {
            let mut bodies = [0; 2];
            for (which, body) in bodies.iter_mut().enumerate().take(packed.free.count()) {
                let dof = packed.free.body(which).start;
                let at = &mut self.body_at[dof];
                if *at == 0 {
                    *at = self.dofs.len() as u32;
                    self.dofs.push(dof as u32);
                    self.free.push(0);
                }
                *body = *at;
            }
            let first =
                bodies.iter().fold(open, |first, body| first.max(self.free[*body as usize]));
            let full = |filled: &&u8| usize::from(**filled) == SIDE;
            let at = first as usize + self.filled[first as usize..].iter().take_while(full).count();
            if at == self.filled.len() {
                self.filled.push(0);
            }
            self.filled[at] += 1;
            open += self.filled[open as usize..].iter().take_while(full).count() as u32;
            for body in bodies.into_iter().filter(|body| *body > 0) {
                self.free[body as usize] = at as u32 + 1;
            }
            self.places.push((bodies, at as u32));
            if self.places.len() == SEEN && 4 * self.filled.len() > 3 * SEEN {
                break;
            }
        }
        for dof in &self.dofs[1..] {
            self.body_at[*dof as usize] = 0;
        }
        self.places.len() > SEEN && self.places.len() >= 2 * self.filled.len()
    }

    /// Loads the bodies' u.
    fn load(&mut self, u: &[R]) {
        for (body, dof) in self.bodies.iter_mut().zip(&self.dofs).skip(1) {
            body.0.copy_from_slice(&u[*dof as usize..][..SIX]);
        }
    }

    /// Writes impulses and u.
    pub fn store(&self, rows: &mut Rows<R>) {
        for (body, dof) in self.bodies.iter().zip(&self.dofs).skip(1) {
            rows.u[*dof as usize..][..SIX].copy_from_slice(&body.0);
        }
        for four in &self.fours {
            for (lane, row) in four.rows.iter().enumerate().filter(|(_, row)| **row != NOBODY) {
                for (row, impulse) in rows.rows[*row as usize..].iter_mut().zip(&four.point.impulse)
                {
                    row.impulse = impulse.0[lane];
                }
            }
        }
    }

    /// Updates every contact.
    pub fn sweep(&mut self) -> Swept<R> {
        let most = |each: Each<R>| each.0.into_iter().fold(R::zero(), R::max);
        if self.moved.is_empty() {
            return Swept { change: most(self.sweep_plain()), gain: R::zero() };
        }
        let (largest, sums) = self.sweep_on(&self.step.unwrap_or(Step::none()));
        let [gain, own, both] = sums.map(|Each(each)| (each[0] + each[1]) + (each[2] + each[3]));
        self.found = Found { gain, own, both };
        let fall = if self.step.is_some() { self.momentum.fall() } else { R::zero() };
        Swept { change: most(largest), gain: fall + gain }
    }

    #[inline(never)]
    fn sweep_plain(&mut self) -> Each<R> {
        let mut largest = Each::every(0.0);
        for four in &mut self.fours {
            largest = four.update(&mut self.bodies, largest, |_, _, _| {});
        }
        largest
    }

    /// With momentum; returns the largest changes and the sums of `Found`.
    #[inline(never)]
    fn sweep_on(&mut self, step: &Step<R>) -> (Each<R>, [Each<R>; 3]) {
        let none = Each::every(0.0);
        let (mut largest, mut sum, mut own, mut both) = (none, none, none, none);
        for (four, Moved { s, from, last }) in self.fours.iter_mut().zip(&mut self.moved) {
            for i in 0..EDGES {
                step.go(&mut four.point.impulse[i].0, &mut from[i].0, &mut last[i].0);
            }
            largest = four.update(&mut self.bodies, largest, |i, change, short| {
                sum = sum + gain(s[i], change, short);
            });
            for i in 0..EDGES {
                let p = four.point.impulse[i] - from[i];
                let weighted = four.point.c[i] * p;
                own = own + weighted * p;
                both = both + weighted * last[i];
            }
        }
        (largest, [sum, own, both])
    }
}

impl<R: Real> Four<R> {
    fn empty() -> Self {
        Self {
            point: Point::empty(),
            inv_d: [[Each::every(0.0); SIX]; 2],
            bodies: [[0; SIDE]; 2],
            rows: [NOBODY; SIDE],
        }
    }

    fn set(&mut self, lane: usize, row: u32, bodies: [u32; 2], packed: &Packed<R>, inv_d: &[R]) {
        self.rows[lane] = row;
        self.point.set(lane, &packed.point);
        for which in 0..packed.free.count() {
            self.bodies[which][lane] = bodies[which];
            let inv_d = &inv_d[packed.free.body(which)];
            for k in 0..SIX {
                self.inv_d[which][k].0[lane] = inv_d[k];
            }
        }
    }

    /// Updates each; `note` receives each edge's changes and shortfalls.
    #[inline(always)]
    fn update(
        &mut self,
        bodies: &mut [Six<R>],
        largest: Each<R>,
        note: impl FnMut(usize, Each<R>, Each<R>),
    ) -> Each<R> {
        let [one, two] = [0, 1].map(|which| gather(bodies, &self.bodies[which]));
        let change = self.point.edges(self.point.velocity(&one, Some(&two)), |change| change, note);
        let largest = self.point.add(&change, largest);
        let mut kicked = [[Each::every(0.0); SIX]; 2];
        self.kick(bodies, &along(&change), &mut kicked);
        scatter(bodies, &self.bodies[0], &kicked[0]);
        scatter(bodies, &self.bodies[1], &kicked[1]);
        largest
    }

    /// Returns the bodies' u + D⁻¹ Σ y f. Not inlined: the products would be ordered body by body,
    /// as their sums are stored.
    #[inline(never)]
    fn kick(&self, bodies: &[Six<R>], f: &[Each<R>; NARROW], out: &mut [[Each<R>; SIX]; 2]) {
        for which in 0..2 {
            let u = gather(bodies, &self.bodies[which]);
            for k in 0..SIX {
                out[which][k] = u[k] + self.inv_d[which][k] * self.point.push(which, k, f);
            }
        }
    }
}

/// Returns the bodies' u, side by side.
#[inline(always)]
fn gather<R: Real>(bodies: &[Six<R>], at: &[u32; SIDE]) -> [Each<R>; SIX] {
    let mut u = [Each::every(0.0); SIX];
    for l in 0..SIDE {
        let own = &bodies[at[l] as usize].0;
        for k in 0..SIX {
            u[k].0[l] = own[k];
        }
    }
    u
}

#[inline(always)]
fn scatter<R: Real>(bodies: &mut [Six<R>], at: &[u32; SIDE], u: &[Each<R>; SIX]) {
    for l in 0..SIDE {
        let own = &mut bodies[at[l] as usize].0;
        for k in 0..SIX {
            own[k] = u[k].0[l];
        }
    }
}
