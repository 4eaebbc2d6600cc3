//! Measurements at a site: motion, forces, the distance ahead, and objects inside.

use super::Reading;
use crate::real::Real;
use crate::scene::{Sensor, SensorField, SensorType};
use crate::shapes::ray::{self, inside, Ray};
use crate::spatial::{Pose, V3};
use crate::watch::{first_hit, RayFilter};

impl<R: Real> Reading<'_, R> {
    /// Accelerometer, velocimeter, gyro, force and torque, in the axes of the site.
    pub(super) fn at_site(&mut self, sensor: &Sensor) -> V3<f64> {
        let Some(object) = sensor.object else { return V3::zeros() };
        let pose = self.pose(Some(object));
        let found = match sensor.kind {
            SensorType::Velocimeter => self.motion(Some(object)).lin,
            SensorType::Gyro => self.motion(Some(object)).ang,
            SensorType::Accelerometer => self.point_acceleration(object).lin,
            _ => {
                // The force between the body and its parent, about the site.
                let body = self.body_of(object);
                let from = self.bodies.about(body);
                let wrench = self.forces().internal[body];
                match sensor.kind {
                    SensorType::Force => wrench.lin,
                    _ => wrench.ang + (from - pose.pos).cross(&wrench.lin),
                }
            }
        };
        pose.to_local(&found)
    }

    /// The geom that a ray along the site's z axis meets; the site's body is left out.
    pub(super) fn range(&self, sensor: &Sensor, out: &mut Vec<f64>) {
        let pose = self.pose(sensor.object);
        let excluded = sensor.object.map(|object| self.body_of(object));
        let filter = RayFilter { excluded, ..RayFilter::default() };
        let along = pose.axis(2);
        let hit = first_hit(self.model(), &self.bodies, &pose.pos, &along, &filter);
        let (met, at) = (hit.is_some(), hit.map_or(-1.0, |(_, hit)| hit.at));
        let or_zero = |v: V3<f64>| if met { v } else { V3::zeros() };
        for field in &sensor.data {
            match field {
                SensorField::Dist | SensorField::Depth => out.push(at),
                SensorField::Dir => out.extend(or_zero(along).iter()),
                SensorField::Origin => out.extend(pose.pos.iter()),
                SensorField::Point => out.extend(or_zero(pose.pos + along * at).iter()),
                _ => out.extend(hit.map_or(V3::zeros(), |(_, hit)| hit.normal).iter()),
            }
        }
    }

    /// Pose of a site that is a volume.
    pub(super) fn volume(&self, site: usize) -> Pose<f64> {
        let site = &self.model().sites[site];
        self.bodies.pose(site.body, &site.pos, &site.quat)
    }

    /// Whether a point is within the volume of a site.
    pub(super) fn within(&self, site: usize, point: &V3<f64>) -> bool {
        let pose = self.volume(site);
        let site = &self.model().sites[site];
        inside(site.kind, &site.size, &pose.to_local(&(point - pose.pos)))
    }

    /// Whether a ray starts in the volume of a site or meets it.
    pub(super) fn sees(&self, site: usize, from: &V3<f64>, along: &V3<f64>) -> bool {
        let pose = self.volume(site);
        let site = &self.model().sites[site];
        let ray = Ray { from: pose.to_local(&(from - pose.pos)), along: pose.to_local(along) };
        ray::primitive(site.kind, &site.size, &ray).is_some()
    }

    /// 1 if the object's origin is within the site, else 0.
    pub(super) fn inside(&self, sensor: &Sensor) -> f64 {
        let point = self.pose(sensor.object).pos;
        let within = sensor.reference.is_some_and(|site| self.within(site.index, &point));
        f64::from(u8::from(within))
    }
}
