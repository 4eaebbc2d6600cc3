//! Contact sensors: a fixed number of the matching contacts, each with a fixed number of values.

use super::Reading;
use crate::model::Model;
use crate::real::{Constant, Real};
use crate::scene::{ObjectType, Reduce, Sensor, SensorField, SensorObject};
use crate::spatial::V3;

/// A contact as a sensor reports it: in the frame (normal, tangent, normal × tangent), the normal
/// from the sensor's first object to its second.
struct Told {
    bodies: [usize; 2],
    pos: V3<f64>,
    dist: f64,
    axes: [V3<f64>; 3],
    /// Force on the second object, in these axes.
    force: V3<f64>,
    torque: V3<f64>,
}

impl<N: Constant> Model<N> {
    /// Whether a body is another, or hangs on it.
    pub(super) fn hangs_on(&self, mut body: usize, top: usize) -> bool {
        while body > top {
            body = self.bodies[body].parent;
        }
        body == top
    }
}

impl<R: Real> Reading<'_, R> {
    pub(super) fn contacts(&self, sensor: &Sensor, out: &mut Vec<f64>) {
        let mut told = self.matching(sensor);
        let found = told.len();
        match sensor.reduce {
            Reduce::None => {}
            Reduce::MinDist => told.sort_by(|a, b| a.dist.total_cmp(&b.dist)),
            Reduce::MaxForce => {
                told.sort_by(|a, b| b.force.norm().total_cmp(&a.force.norm()));
            }
            Reduce::NetForce => told = net(&told).into_iter().collect(),
        }
        for slot in 0..sensor.num {
            for field in &sensor.data {
                match told.get(slot) {
                    Some(contact) => self.tell(contact, *field, found, out),
                    None => out.extend([0.0; 3].iter().take(field.size())),
                }
            }
        }
    }

    /// The matching contacts in their order.
    fn matching(&self, sensor: &Sensor) -> Vec<Told> {
        let model = self.model();
        let mut all = vec![];
        for (_, contact) in self.sim.live_contacts(self.lane) {
            let lane = |v: &V3<R>| v.map(|x| x.lane(self.lane));
            let geoms = [contact.pair.geom1, contact.pair.geom2];
            let pos = lane(&contact.pos);
            let Some(flipped) = self.matches(sensor, geoms, &pos) else { continue };
            let mut bodies = geoms.map(|geom| model.geoms[geom].body);
            let [mut tangent, _] = contact.tangents(&self.sim.placed).map(|t| lane(&t));
            let mut normal = lane(&contact.normal);
            let wrench = self.sim.contact_wrench(contact, self.lane);
            let mut force = V3::from_column_slice(&wrench[..3]);
            let mut torque = V3::from_column_slice(&wrench[3..]);
            if flipped {
                bodies.reverse();
                (normal, tangent, force, torque) = (-normal, -tangent, -force, -torque);
            }
            let axes = [normal, tangent, normal.cross(&tangent)];
            let local = |v: V3<f64>| V3::from_fn(|k, _| axes[k].dot(&v));
            let (force, torque) = (local(force), local(torque));
            let dist = contact.dist.lane(self.lane);
            all.push(Told { bodies, pos, dist, axes, force, torque });
        }
        all
    }

    /// Whether a contact matches the sensor, and if so whether its second geom is the sensor's
    /// first object. If its first geom is too, the answer is no.
    fn matches(&self, sensor: &Sensor, geoms: [usize; 2], pos: &V3<f64>) -> Option<bool> {
        let is = |object: Option<SensorObject>, geom: usize| match object {
            None => true,
            Some(SensorObject { kind: ObjectType::Site, .. }) => true,
            Some(SensorObject { kind: ObjectType::Geom, index }) => geom == index,
            Some(SensorObject { kind: ObjectType::XBody, index }) => {
                self.model().hangs_on(self.model().geoms[geom].body, index)
            }
            Some(SensorObject { index, .. }) => self.model().geoms[geom].body == index,
        };
        if let Some(SensorObject { kind: ObjectType::Site, index }) = sensor.object {
            if !self.within(index, pos) {
                return None;
            }
        }
        let [one, two] = geoms;
        if is(sensor.object, one) && is(sensor.reference, two) {
            return Some(false);
        }
        (is(sensor.object, two) && is(sensor.reference, one)).then_some(true)
    }

    fn tell(&self, contact: &Told, field: SensorField, found: usize, out: &mut Vec<f64>) {
        let relative = || {
            let [one, two] = contact.bodies.map(|body| self.bodies.velocity_at(body, &contact.pos));
            let local = |v: V3<f64>| V3::from_fn(|k, _| contact.axes[k].dot(&v));
            (local(two.lin - one.lin), local(two.ang - one.ang))
        };
        match field {
            SensorField::Found => out.push(found as f64),
            SensorField::Dist => out.push(contact.dist),
            SensorField::Force => out.extend(contact.force.iter()),
            SensorField::Torque => out.extend(contact.torque.iter()),
            SensorField::Pos => out.extend(contact.pos.iter()),
            SensorField::Normal => out.extend(contact.axes[0].iter()),
            SensorField::Tangent => out.extend(contact.axes[1].iter()),
            SensorField::LinVel => out.extend(relative().0.iter()),
            _ => out.extend(relative().1.iter()),
        }
    }
}

/// One contact at the centroid of all, weighted by the size of their forces, in world axes, with
/// the same force and moment as all together.
fn net(told: &[Told]) -> Option<Told> {
    let world =
        |contact: &Told, v: &V3<f64>| -> V3<f64> { (0..3).map(|k| contact.axes[k] * v[k]).sum() };
    let weight: f64 = told.iter().map(|contact| contact.force.norm()).sum();
    let first = told.first()?;
    let mut pos: V3<f64> = told.iter().map(|contact| contact.pos * contact.force.norm()).sum();
    pos = if weight > 0.0 { pos / weight } else { V3::zeros() };
    let (mut force, mut torque) = (V3::zeros(), V3::zeros());
    for contact in told {
        let own = world(contact, &contact.force);
        force += own;
        torque += world(contact, &contact.torque) + (contact.pos - pos).cross(&own);
    }
    let axes = [V3::x(), V3::y(), V3::z()];
    Some(Told { bodies: first.bodies, pos, dist: 0.0, axes, force, torque })
}
