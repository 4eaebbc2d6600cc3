//! Pairs of geoms: those that are tested, and those that are not.

use std::collections::BTreeMap;

use super::{split, Of, Print};
use crate::model::Model;
use crate::settings::{Law, Settings};

impl Print {
    pub(super) fn pairs(&mut self, model: &Model, settings: &Settings) {
        if model.dynamic_pairs.is_some() {
            for ((one, two), count) in model.tally().meet {
                let name = format!("{}-{} pairs, found as they come near", one.word(), two.word());
                let why = "a heap: too many pairs could meet for a list of them".into();
                let entry = self.push("detect", name, Of::Pair, vec![], true, why);
                entry.kind("pair").counting(count);
            }
        }
        let skips = matches!(settings.law, Law::SolRef | Law::Penalty);
        // In the order in which shapes come first.
        let mut by_shapes: Vec<(String, Vec<usize>)> = vec![];
        for (index, pair) in model.pairs.iter().enumerate() {
            if skips && pair.apart {
                continue;
            }
            let [a, b] = [pair.geom1, pair.geom2].map(|geom| model.geoms[geom].kind.word());
            let name = format!("{a}-{b} pairs");
            match by_shapes.iter_mut().find(|(known, _)| *known == name) {
                Some((_, own)) => own.push(index),
                None => by_shapes.push((name, vec![index])),
            }
        }
        for (name, own) in by_shapes {
            self.does("detect", name, Of::Pair, own).kind("pair");
        }
        let [apart, _] = split(model.pairs.len(), |pair| model.pairs[pair].apart);
        if skips && !apart.is_empty() {
            let guards: BTreeMap<usize, &str> =
                model.guards.iter().map(|g| (g.joint, &*model.joints[g.joint].name)).collect();
            let joints = guards.into_values().collect::<Vec<_>>().join(", ");
            let why = format!("kept apart by the ranges of {joints}; tested only outside them");
            self.omits("detect", "pairs", Of::Pair, apart, why).kind("pair");
        }
        let ghost =
            |geom: usize| model.geoms[geom].contype == 0 && model.geoms[geom].conaffinity == 0;
        let [ghosts, _] = split(model.geoms.len(), ghost);
        let why = "contype and conaffinity are 0";
        self.omits("detect", "all pairs of geoms", Of::Geom, ghosts, why).kind("pair");
    }
}
