//! Distances between geoms: the closest two points of two geoms, or of the geoms of two bodies.

use super::Reading;
use crate::real::Real;
use crate::scene::{ObjectType, Sensor, SensorObject, SensorType};
use crate::shapes::{meet, Shape, ShapeTest};
use crate::spatial::V3;

/// The shortest way from the first geom to the second.
struct Gap {
    dist: f64,
    from: V3<f64>,
    to: V3<f64>,
}

impl<R: Real> Reading<'_, R> {
    /// Distance, direction or both ends. Nothing is found beyond the cutoff.
    pub(super) fn apart(&self, sensor: &Sensor, out: &mut Vec<f64>) {
        let geoms = |object: Option<SensorObject>| match object {
            Some(SensorObject { kind: ObjectType::Geom, index }) => vec![index],
            Some(object) => {
                let of = |geom: &usize| self.model().geoms[*geom].body == object.index;
                (0..self.model().geoms.len()).filter(of).collect()
            }
            None => vec![],
        };
        let (first, second) = (geoms(sensor.object), geoms(sensor.reference));
        let mut best: Option<Gap> = None;
        let most = sensor.cutoff.max(0.0);
        for (one, two) in first.iter().flat_map(|one| second.iter().map(move |two| (*one, *two))) {
            let gap = self.gap(one, two, most).filter(|gap| gap.dist < most);
            best = match (best, gap) {
                (Some(best), Some(gap)) => Some(if gap.dist < best.dist { gap } else { best }),
                (best, gap) => best.or(gap),
            };
        }
        match (sensor.kind, best) {
            (SensorType::Distance, best) => out.push(best.map_or(sensor.cutoff, |gap| gap.dist)),
            (SensorType::Normal, best) => {
                let way = best.map_or(V3::zeros(), |gap| gap.to - gap.from);
                let length = way.norm();
                out.extend((if length > 0.0 { way / length } else { way }).iter());
            }
            (_, Some(gap)) => out.extend(gap.from.iter().chain(gap.to.iter())),
            (_, None) => out.extend([0.0; 6]),
        }
    }

    fn gap(&self, geom1: usize, geom2: usize, most: f64) -> Option<Gap> {
        let geoms = &self.model().geoms;
        // The order in which tests take their shapes.
        let rank = |geom: usize| (geoms[geom].kind, geoms[geom].body, geom);
        let swapped = rank(geom1) > rank(geom2);
        let ends = if swapped { [geom2, geom1] } else { [geom1, geom2] };
        let test = ShapeTest::of(geoms[ends[0]].kind, geoms[ends[1]].kind)?;
        let poses = ends.map(|geom| {
            let geom = &geoms[geom];
            self.bodies.pose(geom.body, &geom.pos, &geom.quat)
        });
        let [a, b]: [Shape<f64>; 2] =
            [geoms[ends[0]].shape(&poses[0]), geoms[ends[1]].shape(&poses[1])];
        let mut best: Option<Gap> = None;
        meet(test, &a, &b, (|_| most, &[]), |_, touch| {
            if !touch.exists || best.as_ref().is_some_and(|best| best.dist <= touch.dist) {
                return;
            }
            let half = touch.normal * (0.5 * touch.dist);
            let (from, to) = (touch.pos - half, touch.pos + half);
            let (from, to) = if swapped { (to, from) } else { (from, to) };
            best = Some(Gap { dist: touch.dist, from, to });
        });
        best
    }
}
