//! Forces of a fluid on a body that moves through it. MuJoCo documentation, "Fluid forces": drag by the
//! square of the velocity and viscous resistance by the velocity, of a box with the inertia of the
//! body; or, for each of its geoms that counts as an ellipsoid, these and lift, and the curved path of
//! the fluid that moves with it (but not the inertia of that fluid, as in MuJoCo).
//!
//! All is written in the axes of the shape, with its velocity v relative to the fluid at its centre and
//! its angular velocity ω. With u = v/|v|, g the squared areas across the axes over the largest (a₀),
//! N = Σ g v², D = Σ g² v²: the area across the way is A = a₀ √(D/N), and
//!
//! ```text
//! Kutta    C a₀ √(N/D)/|v| (N v − |v|² g∘v)        Magnus   C V ρ ω × v
//! drag     −(ρ|v| (C_b A + C_s (A_max − A)) + μ c) v, and −(|K∘ω| + μ c') ω of its turn
//! moved    (m∘v) × ω, and (m∘v) × v + (I∘ω) × ω of its turn
//! ```

use super::applied::at_point;
use super::force::{Forces, Group, Moment};
use super::Kind;
use crate::model::fluid::{Ellipsoid, Part, Shape};
use crate::model::{Model, NONE};
use crate::plan::acting::Why;
use crate::real::{Constant, Real};
use crate::spatial::{rotate, rotate_back, splat, Force, Motion, M3, V3};

pub(super) struct Fluid;

/// A moving shape of a body.
struct Moving<R: Real> {
    /// Its axes in the world.
    rot: M3<R>,
    /// Its centre, from its tree's origin [m].
    arm: V3<R>,
    /// Its velocity relative to the fluid, in the axes of the shape.
    velocity: Motion<R>,
}

impl<R: Real> Moving<R> {
    fn of(now: &Moment<R>, body: usize, part: &Part) -> Self {
        let (model, frames) = (now.model, &now.frames);
        let own = &model.bodies[body];
        let turn = &frames.xmat[body];
        let rot = turn * part.rot.map(R::of);
        let at = frames.xpos[body] + rotate(turn, &splat(&part.pos));
        let arm = at - frames.origin[own.tree];
        let mut moves = Motion::zero();
        for &k in own.chain.of(&model.dof_lists) {
            moves.add_scaled(&frames.motion[k], now.qvel[k]);
        }
        let lin = moves.at(&arm) - splat::<R, _>(&model.fluid.wind);
        let velocity = Motion { ang: rotate_back(&rot, &moves.ang), lin: rotate_back(&rot, &lin) };
        Self { rot, arm, velocity }
    }

    /// Returns the contribution of one unit of a dof's velocity to `velocity`.
    fn by(&self, motion: &Motion<R>) -> Motion<R> {
        Motion {
            ang: rotate_back(&self.rot, &motion.ang),
            lin: rotate_back(&self.rot, &motion.at(&self.arm)),
        }
    }
}

impl Forces for Fluid {
    const KIND: Kind = Kind::Fluid;
    const GROUP: Group = Group::Passive;

    /// The body.
    type At<N: Constant> = usize;

    fn at(model: &Model, body: usize) -> Result<usize, Why> {
        let wet = model.bodies[body].tree != NONE && model.fluid.of_body[body].len > 0;
        wet.then_some(body).ok_or(Why::Unsaid)
    }

    fn force<R: Real>(now: &Moment<R>, &body: &usize, add: &mut impl FnMut(usize, R)) {
        for part in now.model.fluid.of_body[body].of(&now.model.fluid.parts) {
            let moving = Moving::of(now, body, part);
            let push = resistance(part, &moving.velocity);
            let [force, moment] = [&push.lin, &push.ang].map(|x| rotate(&moving.rot, x));
            at_point(now, body, &moving.arm, &force, &moment, add);
        }
    }

    fn slopes<R: Real>(now: &Moment<R>, &body: &usize, add: &mut dyn FnMut(usize, usize, [R; 2])) {
        let model = now.model;
        for part in model.fluid.of_body[body].of(&model.fluid.parts) {
            let moving = Moving::of(now, body, part);
            let slope = Slope::of(part, &moving.velocity);
            let chain = model.bodies[body].chain.of(&model.dof_lists);
            for &j in chain {
                let push = slope.along(&moving.by(&now.frames.motion[j]));
                for &i in chain {
                    let own = moving.by(&now.frames.motion[i]);
                    add(i, j, [R::zero(), -own.dot(&push)]);
                }
            }
        }
    }

    fn sloped<N: Constant>(model: &Model<N>, &body: &usize, each: &mut impl FnMut(usize)) {
        model.bodies[body].chain.of(&model.dof_lists).iter().for_each(|k| each(*k));
    }

    fn damps<N: Constant>(_: &Model<N>, _: &usize) -> bool {
        true
    }

    /// A fluid at rest only takes energy.
    #[inline(always)]
    fn powers<R: Real>(now: &Moment<R>) -> bool {
        !now.model.fluid.parts.is_empty() && now.model.fluid.wind.norm_squared() > 0.0
    }

    fn power<R: Real>(now: &Moment<R>, body: &usize, velocity: &[R], add: &mut impl FnMut(R)) {
        Self::force(now, body, &mut |k, force| add(force * velocity[k]));
    }
}

/// Returns the force and the moment on a shape, in its axes.
fn resistance<R: Real>(part: &Part, velocity: &Motion<R>) -> Force<R> {
    let (v, w) = (&velocity.lin, &velocity.ang);
    let [viscous, twisting] = part.viscous.map(R::of);
    match &part.shape {
        Shape::Box { force, moment } => {
            let resist = |by: &V3<R>, x: &V3<R>, linear: R| {
                -x.zip_map(by, |x, k| (k * x.abs() + linear) * x)
            };
            Force {
                ang: resist(&splat(moment), w, twisting),
                lin: resist(&splat(force), v, viscous),
            }
        }
        Shape::Ellipsoid(own) => {
            let way = Way::of(own, v);
            let (mass, inertia) = (splat::<R, _>(&own.mass), splat::<R, _>(&own.inertia));
            let carried = v.component_mul(&mass);
            let spun = w.component_mul(&inertia);
            let twist = length(&w.component_mul(&splat(&own.turning)));
            let lin = carried.cross(w) + w.cross(v) * R::of(own.magnus) + way.lift(v)
                - v * (way.drag + viscous);
            let ang = carried.cross(v) + spun.cross(w) - w * (twist + twisting);
            Force { ang, lin }
        }
    }
}

/// Orientation of an ellipsoid to its way. At rest, all is zero.
struct Way<R: Real> {
    /// |v|, and one over it.
    speed: R,
    per_speed: R,
    /// g∘v, g²∘v, N and one over D.
    g: V3<R>,
    gg: V3<R>,
    n: R,
    per_d: R,
    /// ρ A.
    area: R,
    /// Kutta's force is this times N v − |v|² g∘v.
    kutta: R,
    /// The drag per unit of v from the area across the way.
    drag: R,
}

/// √ where x > 0, else 0 without slopes.
fn root<R: Real>(x: R) -> R {
    let none = x.le(R::zero());
    R::select(none, R::zero(), R::select(none, R::one(), x).sqrt())
}

fn length<R: Real>(v: &V3<R>) -> R {
    root(v.dot(v))
}

impl<R: Real> Way<R> {
    fn of(own: &Ellipsoid, v: &V3<R>) -> Self {
        let across = splat::<R, _>(&own.across);
        let g = v.component_mul(&across);
        let gg = g.component_mul(&across);
        let (n, d) = (g.dot(v), gg.dot(v));
        let speed = length(v);
        let (per_speed, per_d) = (speed.recip_or_zero(), d.recip_or_zero());
        let area = R::of(own.area) * root(d * n.recip_or_zero());
        let kutta = R::of(own.kutta * own.area) * root(n * per_d) * per_speed;
        let slender = R::of(own.slender) * (R::of(own.most_area) - area);
        let drag = speed * (R::of(own.blunt) * area + slender);
        Self { speed, per_speed, g, gg, n, per_d, area, kutta, drag }
    }

    fn lift(&self, v: &V3<R>) -> V3<R> {
        (v * self.n - self.g * (self.speed * self.speed)) * self.kutta
    }
}

/// Derivatives of the force (`lin`) and of the moment by v and by ω, in the axes of the shape.
struct Slope<R: Real> {
    lin: [M3<R>; 2],
    ang: [M3<R>; 2],
}

impl<R: Real> Slope<R> {
    fn of(part: &Part, velocity: &Motion<R>) -> Self {
        let (v, w) = (&velocity.lin, &velocity.ang);
        let [viscous, twisting] = part.viscous.map(R::of);
        let zero = M3::zeros();
        match &part.shape {
            Shape::Box { force, moment } => {
                let resist = |by: &V3<R>, x: &V3<R>, linear: R| {
                    let each = x.zip_map(by, |x, k| -((k + k) * x.abs() + linear));
                    M3::from_diagonal(&each)
                };
                Self {
                    lin: [resist(&splat(force), v, viscous), zero],
                    ang: [zero, resist(&splat(moment), w, twisting)],
                }
            }
            Shape::Ellipsoid(own) => {
                let (mass, inertia) = (splat::<R, _>(&own.mass), splat::<R, _>(&own.inertia));
                let (m, i) = (M3::from_diagonal(&mass), M3::from_diagonal(&inertia));
                let carried = cross(&v.component_mul(&mass));
                let spun = cross(&w.component_mul(&inertia));
                let (cross_v, cross_w) = (cross(v), cross(w));
                let magnus = R::of(own.magnus);
                let lin_by_v = -(cross_w * m) + cross_w * magnus + Self::way(own, v)
                    - M3::identity() * viscous;
                let lin_by_w = carried - cross_v * magnus;
                let ang_by_v = carried - cross_v * m;
                let turning = splat::<R, _>(&own.turning);
                let kw = w.component_mul(&turning);
                let twist = length(&kw);
                let ang_by_w = spun
                    - cross_w * i
                    - M3::identity() * (twist + twisting)
                    - w * kw.component_mul(&turning).transpose() * twist.recip_or_zero();
                Self { lin: [lin_by_v, lin_by_w], ang: [ang_by_v, ang_by_w] }
            }
        }
    }

    /// Slopes of Kutta's lift and the drag.
    fn way(own: &Ellipsoid, v: &V3<R>) -> M3<R> {
        let way = Way::of(own, v);
        let across = M3::from_diagonal(&splat::<R, _>(&own.across));
        let (unit, square) = (v * way.per_speed, way.speed * way.speed);
        let (by_n, by_d) = (way.g * way.n.recip_or_zero(), way.gg * way.per_d);
        // Relative gradients of A and of the lift's factor, and the gradient of the drag.
        let narrower = by_d - by_n;
        let less = by_n - by_d - unit * way.per_speed;
        let excess = R::of(own.blunt - own.slender) * way.area * way.speed;
        let steeper = unit * (way.drag * way.per_speed) + narrower * excess;
        let two = R::of(2.0);
        let bend = M3::identity() * way.n + v * way.g.transpose() * two
            - across * square
            - way.g * v.transpose() * two;
        let lift = bend * way.kutta + way.lift(v) * less.transpose();
        lift - M3::identity() * way.drag - v * steeper.transpose()
    }

    /// Returns the change of force and moment with a velocity.
    fn along(&self, velocity: &Motion<R>) -> Force<R> {
        Force {
            ang: self.ang[0] * velocity.lin + self.ang[1] * velocity.ang,
            lin: self.lin[0] * velocity.lin + self.lin[1] * velocity.ang,
        }
    }
}

/// Returns the matrix of v × ·.
fn cross<R: Real>(v: &V3<R>) -> M3<R> {
    let zero = R::zero();
    M3::new(zero, -v.z, v.y, v.z, zero, -v.x, -v.y, v.x, zero)
}
