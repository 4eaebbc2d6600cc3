//! Touch: the normal forces of the contacts in a site's volume, or whose force points through it.

use super::{index, Reading};
use crate::real::Real;
use crate::scene::Sensor;
use crate::spatial::V3;

impl<R: Real> Reading<'_, R> {
    /// [N]
    pub(super) fn touch(&self, sensor: &Sensor) -> f64 {
        let model = self.model();
        let site = index(sensor);
        let body = model.sites[site].body;
        let mut sum = 0.0;
        for (_, contact) in self.sim.live_contacts(self.lane) {
            let [one, two] =
                [contact.pair.geom1, contact.pair.geom2].map(|geom| model.geoms[geom].body);
            if body != one && body != two {
                continue;
            }
            let wrench = self.sim.contact_wrench(contact, self.lane);
            let normal: V3<f64> = contact.normal.map(|x| x.lane(self.lane));
            let force = normal.dot(&V3::from_column_slice(&wrench[..3]));
            // The ray goes against the force on the body: into it.
            let along = if body == two { -normal } else { normal };
            let pos = contact.pos.map(|x| x.lane(self.lane));
            if force > 0.0 && self.sees(site, &pos, &along) {
                sum += force;
            }
        }
        sum
    }
}
