//! The rules that a scene must satisfy before it is compiled. Every error names the element, the
//! field, the value and the limit; nothing is built before all hold.

mod tendon;

mod actuator;
mod equality;

use crate::elements::{text, Kind, Text};
use crate::error::{Error, Result};
use crate::scene::{ExplicitPair, Geom, GeomType, Inertial, Joint, JointType, Scene};
use crate::scene::{SleepPolicy, Softness};
use std::collections::HashSet;
use std::fmt;

/// The element or field under test, as an error names it.
struct Subject(Text);

impl Subject {
    fn new(kind: Kind, name: &str, index: usize) -> Self {
        Self(Text::label(kind, name, index))
    }

    fn refuse(&self, field: &str, value: impl fmt::Display, limit: &str) -> Error {
        Error::value(text![&self.0, " ", field], value, limit)
    }

    fn number(&self, field: &str, value: f64, ok: bool, limit: &str) -> Result<()> {
        if value.is_finite() && ok {
            Ok(())
        } else {
            Err(self.refuse(field, value, limit))
        }
    }

    fn finite(&self, field: &str, values: &[f64]) -> Result<()> {
        match values.iter().position(|x| !x.is_finite()) {
            None => Ok(()),
            Some(0) if values.len() == 1 => Err(self.refuse(field, values[0], "finite")),
            Some(i) => Err(self.refuse(&format!("{field}[{i}]"), values[i], "finite")),
        }
    }

    fn not_negative(&self, field: &str, value: f64) -> Result<()> {
        self.number(field, value, value >= 0.0, "finite and >= 0")
    }

    /// Checks that values are finite, and that their length can be a divisor.
    fn direction(&self, field: &str, values: &[f64]) -> Result<()> {
        self.finite(field, values)?;
        let square = values.iter().map(|x| x * x).sum::<f64>();
        if square.is_normal() {
            Ok(())
        } else {
            Err(self.refuse(
                field,
                format!("{values:?}"),
                "a vector whose length is > 0 and finite",
            ))
        }
    }

    fn below(&self, field: &str, index: usize, count: usize, what: &str) -> Result<()> {
        if index < count {
            Ok(())
        } else {
            Err(self.refuse(field, index, &format!("the index of a {what}, below {count}")))
        }
    }

    fn range(&self, field: &str, range: [f64; 2]) -> Result<()> {
        self.finite(field, &range)?;
        if range[0] < range[1] {
            Ok(())
        } else {
            Err(self.refuse(field, format!("{range:?}"), "a lower bound, then a greater upper one"))
        }
    }

    fn condim(&self, condim: u32) -> Result<()> {
        if matches!(condim, 1 | 3 | 4 | 6) {
            Ok(())
        } else {
            Err(self.refuse("condim", condim, "1, 3, 4 or 6"))
        }
    }

    fn friction(&self, friction: &[f64]) -> Result<()> {
        let each = friction.iter().enumerate();
        each.into_iter().try_for_each(|(i, mu)| self.not_negative(&format!("friction[{i}]"), *mu))
    }

    fn softness(&self, prefix: &str, soft: &Softness) -> Result<()> {
        let [a, b] = soft.solref;
        self.finite(&format!("{prefix}solref"), &soft.solref)?;
        if !(a > 0.0 && b > 0.0 || a <= 0.0 && b <= 0.0) {
            let limit =
                "both > 0 (time constant, damping ratio) or both <= 0 (-stiffness, -damping)";
            return Err(self.refuse(
                &format!("{prefix}solref"),
                format!("{:?}", soft.solref),
                limit,
            ));
        }
        for (i, x) in soft.solimp.iter().enumerate() {
            self.not_negative(&format!("{prefix}solimp[{i}]"), *x)?;
        }
        Ok(())
    }
}

pub fn scene(scene: &Scene) -> Result<()> {
    let whole = Subject("scene".into());
    whole.finite("gravity", &scene.gravity)?;
    whole.not_negative("density", scene.density)?;
    whole.not_negative("viscosity", scene.viscosity)?;
    whole.finite("wind", &scene.wind)?;
    if scene.bodies.is_empty() {
        return Err(Error::Scene("the scene has no world: its first body".into()));
    }
    let rules = Subject("mass rules".into());
    rules.not_negative("bound_mass", scene.mass_rules.bound_mass)?;
    rules.not_negative("bound_inertia", scene.mass_rules.bound_inertia)?;
    rules.finite("total_mass", &[scene.mass_rules.total_mass])?;

    names(scene)?;
    bodies(scene)?;
    let nbody = scene.bodies.len();
    joints(scene)?;
    assets(scene)?;
    for (i, g) in scene.geoms.iter().enumerate() {
        let e = Subject::new(Kind::Geom, &g.name, i);
        e.below("body", g.body, nbody, "body")?;
        geom(&e, g)?;
        asset(&e, g, scene)?;
    }
    grouped(Kind::Geom, scene.geoms.iter().map(|g| (&*g.name, g.body)))?;
    for (i, s) in scene.sites.iter().enumerate() {
        let e = Subject::new(Kind::Site, &s.name, i);
        e.below("body", s.body, nbody, "body")?;
        e.finite("pos", &s.pos)?;
        e.direction("quat", &s.quat)?;
    }
    grouped(Kind::Site, scene.sites.iter().map(|s| (&*s.name, s.body)))?;
    tendon::tendons(scene)?;
    for (i, a) in scene.actuators.iter().enumerate() {
        actuator::check(&Subject::new(Kind::Actuator, &a.name, i), a, scene)?;
    }
    for (i, q) in scene.equalities.iter().enumerate() {
        equality::check(&Subject::new(Kind::Equality, &q.name, i), q, scene)?;
    }
    for (i, pair) in scene.excludes.iter().enumerate() {
        let e = Subject(format!("exclude {i}").into());
        e.below("body1", pair[0], nbody, "body")?;
        e.below("body2", pair[1], nbody, "body")?;
    }
    for (i, p) in scene.pairs.iter().enumerate() {
        let name = if p.name.is_empty() { i.to_string() } else { format!("`{}`", p.name) };
        pair(&Subject(format!("pair {name}").into()), p, scene.geoms.len())?;
    }
    if let Some(o) = &scene.contact_override {
        let e = Subject("contact override".into());
        e.finite("margin", &[o.margin])?;
        e.friction(&o.friction)?;
        e.softness("", &o.soft)?;
    }
    keys(scene)
}

fn names(scene: &Scene) -> Result<()> {
    fn once<'a>(kind: &str, names: impl Iterator<Item = &'a String>) -> Result<()> {
        let mut seen = HashSet::new();
        for name in names {
            if !name.is_empty() && !seen.insert(name) {
                return Err(Error::Scene(
                    format!("two {kind} have the name '{name}': a name stands for one element")
                        .into(),
                ));
            }
        }
        Ok(())
    }
    once("bodies", scene.bodies.iter().map(|x| &x.name))?;
    once("joints", scene.joints.iter().map(|x| &x.name))?;
    once("geoms", scene.geoms.iter().map(|x| &x.name))?;
    once("sites", scene.sites.iter().map(|x| &x.name))?;
    once("tendons", scene.tendons.iter().map(|x| &x.name))?;
    once("actuators", scene.actuators.iter().map(|x| &x.name))?;
    once("equalities", scene.equalities.iter().map(|x| &x.name))?;
    once("pairs", scene.pairs.iter().map(|x| &x.name))?;
    once("keys", scene.keys.iter().map(|x| &x.name))
}

/// Bodies are depth first: a body follows its parent's subtree up to there, which makes the dofs of
/// a tree, and MuJoCo's order of qpos, contiguous.
fn bodies(scene: &Scene) -> Result<()> {
    let (mut path, mut moves) = (vec![0], Vec::with_capacity(scene.bodies.len()));
    for (i, b) in scene.bodies.iter().enumerate() {
        let e = Subject::new(Kind::Body, &b.name, i);
        e.finite("pos", &b.pos)?;
        e.direction("quat", &b.quat)?;
        e.finite("gravcomp", &[b.gravcomp])?;
        let jointed = scene.joints.iter().any(|joint| joint.body == i);
        let carried = i > 0 && moves.get(b.parent).is_some_and(|moves| *moves);
        moves.push(jointed || carried);
        if b.sleep != SleepPolicy::Auto && carried {
            let limit = "'auto': only the root of a tree says how it sleeps";
            return Err(e.refuse("sleep", b.sleep.name(), limit));
        }
        if b.mocap && (i == 0 || b.parent != 0 || jointed) {
            return Err(e.refuse("mocap", true, "a child of the world without joints"));
        }
        if let Some(x) = &b.inertial {
            inertial(&e, x)?;
        }
        if i == 0 {
            continue;
        }
        e.below("parent", b.parent, i, "body listed before it")?;
        while path.last().is_some_and(|p| *p != b.parent) {
            path.pop();
        }
        if path.is_empty() {
            return Err(e.refuse(
                "parent",
                b.parent,
                "the body before it or one of that body's ancestors (depth first)",
            ));
        }
        path.push(i);
    }
    Ok(())
}

fn inertial(e: &Subject, x: &Inertial) -> Result<()> {
    e.not_negative("inertial mass", x.mass)?;
    e.finite("inertial pos", &x.pos)?;
    e.finite("inertial inertia", &x.inertia)?;
    if let Some(axes) = &x.axes {
        e.direction("inertial axes", axes)?;
    }
    for i in 0..3 {
        e.not_negative(&format!("inertial inertia[{i}]"), x.inertia[i])?;
    }
    Ok(())
}

/// Elements of one kind are in the order of their bodies.
fn grouped<'a>(kind: Kind, elements: impl Iterator<Item = (&'a str, usize)>) -> Result<()> {
    let mut last = 0;
    for (i, (name, body)) in elements.enumerate() {
        if body < last {
            let e = Subject::new(kind, name, i);
            return Err(e.refuse(
                "body",
                body,
                &format!(">= {last}: {}s are listed in the order of their bodies", kind.word()),
            ));
        }
        last = body;
    }
    Ok(())
}

fn joints(scene: &Scene) -> Result<()> {
    let (mut dofs, mut ball) = (vec![0; scene.bodies.len()], vec![false; scene.bodies.len()]);
    for (i, j) in scene.joints.iter().enumerate() {
        let e = Subject::new(Kind::Joint, &j.name, i);
        e.below("body", j.body, scene.bodies.len(), "body")?;
        joint(&e, j)?;
        let body = &scene.bodies[j.body];
        let owner = Text::label(Kind::Body, &body.name, j.body);
        if j.body == 0 {
            return Err(Error::Scene(text![&e.0, " is on the world, which does not move"]));
        }
        if j.kind == JointType::Free && body.parent != 0 {
            return Err(Error::Scene(text![
                &e.0,
                " is free, but ",
                owner,
                " is not a child of the world"
            ]));
        }
        if ball[j.body] && matches!(j.kind, JointType::Ball | JointType::Hinge) {
            return Err(Error::Scene(text![
                &e.0,
                " turns ",
                owner,
                " after a ball joint, which already turns it"
            ]));
        }
        ball[j.body] |= j.kind == JointType::Ball;
        dofs[j.body] += j.kind.dofs();
        if dofs[j.body] > 6 {
            return Err(Error::Scene(text![
                &e.0,
                " brings ",
                owner,
                format!(" to {} dofs; a body has at most 6", dofs[j.body])
            ]));
        }
    }
    grouped(Kind::Joint, scene.joints.iter().map(|j| (&*j.name, j.body)))
}

fn joint(e: &Subject, j: &Joint) -> Result<()> {
    e.finite("pos", &j.pos)?;
    if matches!(j.kind, JointType::Hinge | JointType::Slide) {
        e.direction("axis", &j.axis)?;
    }
    match j.range {
        Some(range) if j.kind == JointType::Ball => {
            e.finite("range", &range)?;
            e.number("range[0]", range[0], range[0] == 0.0, "0 for a ball joint")?;
            e.not_negative("range[1]", range[1])?;
        }
        Some(range) => e.range("range", range)?,
        None => {}
    }
    e.finite("margin", &[j.margin])?;
    e.finite("reference", &[j.reference])?;
    e.finite("springref", &[j.springref])?;
    // A spring that pushes away is allowed, as in MuJoCo.
    e.finite("stiffness", &j.stiffness)?;
    e.finite("damping", &j.damping)?;
    e.not_negative("damping", j.damping[0])?;
    e.finite("springdamper", &j.springdamper)?;
    e.not_negative("armature", j.armature)?;
    e.not_negative("frictionloss", j.frictionloss)?;
    e.softness("limit ", &j.limit)?;
    e.softness("friction ", &j.friction)
}

fn geom(e: &Subject, g: &Geom) -> Result<()> {
    e.finite("pos", &g.pos)?;
    e.direction("quat", &g.quat)?;
    let used = match g.kind {
        // A primitive fitted to a mesh takes its size from there.
        _ if g.mesh.is_some() => 0,
        GeomType::Plane | GeomType::HField | GeomType::Mesh => 0,
        GeomType::Sphere => 1,
        GeomType::Capsule | GeomType::Cylinder => 2,
        GeomType::Ellipsoid | GeomType::Box => 3,
    };
    e.finite("size", &g.size)?;
    for (i, size) in g.size.iter().enumerate() {
        let ok = if i < used { *size > 0.0 } else { *size >= 0.0 };
        e.number(
            &format!("size[{i}]"),
            *size,
            ok,
            if i < used { "finite and > 0 m" } else { "finite and >= 0 m" },
        )?;
    }
    if let Some(mass) = g.mass {
        e.not_negative("mass", mass)?;
    }
    e.not_negative("density", g.density)?;
    e.condim(g.condim)?;
    e.friction(&g.friction)?;
    e.finite("margin", &[g.margin])?;
    e.not_negative("gap", g.gap)?;
    e.finite("surfacevel", &g.surfacevel)?;
    e.not_negative("adhesion", g.adhesion)?;
    e.not_negative("solmix", g.solmix)?;
    e.finite("fluidcoef", &g.fluidcoef)?;
    e.softness("", &g.soft)
}

fn pair(e: &Subject, p: &ExplicitPair, ngeom: usize) -> Result<()> {
    e.below("geom1", p.geom1, ngeom, "geom")?;
    e.below("geom2", p.geom2, ngeom, "geom")?;
    e.condim(p.condim)?;
    e.friction(&p.friction)?;
    e.finite("margin", &[p.margin])?;
    e.not_negative("gap", p.gap)?;
    e.not_negative("adhesion", p.adhesion)?;
    e.softness("", &p.soft)?;
    let Some([a, b]) = p.solreffriction else { return Ok(()) };
    e.finite("solreffriction", &[a, b])?;
    let limit = "time constant > 0 and damping ratio >= 0, or both <= 0 (-stiffness, -damping)";
    let ok = if a > 0.0 { b >= 0.0 } else { b <= 0.0 };
    e.number("solreffriction[1]", b, ok, limit)
}

/// Checks that the assets of a geom exist, and fit its shape.
fn asset(e: &Subject, g: &Geom, scene: &Scene) -> Result<()> {
    let fits = match g.kind {
        GeomType::Mesh => g.mesh.is_some(),
        GeomType::Plane | GeomType::HField => g.mesh.is_none(),
        _ => true,
    };
    if !fits {
        let limit =
            format!("given for a mesh or a primitive fitted to one; it is a {}", g.kind.word());
        return Err(e.refuse("mesh", g.mesh.map_or("none".into(), |i| i.to_string()), &limit));
    }
    if (g.kind == GeomType::HField) != g.hfield.is_some() {
        let limit = format!("given for a height field only; it is a {}", g.kind.word());
        return Err(e.refuse("hfield", g.hfield.map_or("none".into(), |i| i.to_string()), &limit));
    }
    e.number("fitscale", g.fitscale, g.fitscale > 0.0, "finite and > 0")?;
    if g.kind == GeomType::Mesh && g.shell_inertia {
        let limit = "false for a mesh: its own inertia can be \"shell\"";
        return Err(e.refuse("shell_inertia", true, limit));
    }
    if let Some(mesh) = g.mesh {
        e.below("mesh", mesh, scene.meshes.len(), "mesh")?;
    }
    g.hfield.map_or(Ok(()), |i| e.below("hfield", i, scene.hfields.len(), "height field"))
}

fn assets(scene: &Scene) -> Result<()> {
    let subject = |word: &str, name: &str, i: usize| match name {
        "" => Subject(format!("{word} {i}").into()),
        name => Subject(format!("{word} '{name}'").into()),
    };
    for (i, mesh) in scene.meshes.iter().enumerate() {
        let e = subject("mesh", &mesh.name, i);
        let count = mesh.vertices.len();
        if count < 4 {
            return Err(e.refuse("vertices", count, "at least 4"));
        }
        for (k, vertex) in mesh.vertices.iter().enumerate() {
            e.finite(&format!("vertices[{k}]"), vertex)?;
        }
        for face in mesh.faces.iter() {
            face.iter().try_for_each(|k| e.below("faces", *k, count, "vertex"))?;
        }
        if mesh.maxhullvert.is_some_and(|most| most < 4) {
            return Err(e.refuse("maxhullvert", mesh.maxhullvert.unwrap_or(0), "at least 4"));
        }
    }
    for (i, field) in scene.hfields.iter().enumerate() {
        let e = subject("hfield", &field.name, i);
        e.number("nrow", field.nrow as f64, field.nrow >= 2, "at least 2")?;
        e.number("ncol", field.ncol as f64, field.ncol >= 2, "at least 2")?;
        for (k, size) in field.size.iter().enumerate() {
            e.number(&format!("size[{k}]"), *size, *size > 0.0, "finite and > 0 m")?;
        }
        if Some(field.data.len()) != field.nrow.checked_mul(field.ncol) {
            let limit = format!("nrow × ncol: {} × {}", field.nrow, field.ncol);
            return Err(e.refuse("number of heights", field.data.len(), &limit));
        }
        e.finite("data", &field.data)?;
    }
    Ok(())
}

fn keys(scene: &Scene) -> Result<()> {
    let nq = scene.joints.iter().map(|j| j.kind.positions()).sum();
    let nv = scene.joints.iter().map(|j| j.kind.dofs()).sum();
    let mocaps = scene.bodies.iter().filter(|body| body.mocap).count();
    let na = scene.actuators.iter().map(|a| a.states()).sum();
    for (i, key) in scene.keys.iter().enumerate() {
        let e = Subject::new(Kind::Key, &key.name, i);
        e.finite("time", &[key.time])?;
        let arrays = [
            ("qpos", &key.qpos, nq),
            ("qvel", &key.qvel, nv),
            ("act", &key.act, na),
            ("ctrl", &key.ctrl, scene.actuators.len()),
            ("mpos", &key.mpos, 3 * mocaps),
            ("mquat", &key.mquat, 4 * mocaps),
        ];
        for (field, values, count) in arrays {
            let Some(values) = values else { continue };
            if values.len() != count {
                return Err(e.refuse(
                    &format!("{field} length"),
                    values.len(),
                    &format!("{count}"),
                ));
            }
            e.finite(field, values)?;
        }
    }
    Ok(())
}
