//! Rows of contacts made by several threads: each part of the list by itself, then one after another.

use crate::detect::Contact;
use crate::pool::{inside, lock, WORTH_SHARING};
use crate::real::Real;
use crate::settings::Law;
use crate::solve::{Rows, Situation};
use std::sync::Mutex;

/// Parts of the work for each thread: some are done sooner than others.
const PARTS: usize = 2;

impl<R: Real> Rows<R> {
    /// Checks that threads share the rows of this many contacts. Under other laws, and with geoms that
    /// adhere, a contact changes a list, or data that the next one reads.
    pub(super) fn shares(&self, now: &Situation<R>, contacts: usize) -> bool {
        let heap = now.model.dynamic_pairs.is_some()
            && now.settings.law == Law::SolRef
            && !now.model.sticks;
        heap && self.pool.is_some() && contacts >= WORTH_SHARING
    }

    /// Makes the rows of all contacts, as one thread would.
    pub(super) fn share_contacts(&mut self, now: &Situation<R>, contacts: &[Contact<R>]) {
        let Some(pool) = self.pool.clone() else { return };
        let count = PARTS * pool.threads();
        let mut parts = std::mem::take(&mut self.parts);
        parts.resize_with(count, || Mutex::new(Self::new(now.model)));
        let len = contacts.len().div_ceil(count);
        pool.share(count, &|part| {
            let mut rows = lock(&parts[part]);
            rows.clear();
            let own = contacts.chunks(len.max(1)).nth(part).unwrap_or(&[]);
            rows.soft_contacts(now, own);
        });
        for part in &mut parts {
            self.append(inside(part));
        }
        self.parts = parts;
    }

    /// Moves the rows of others behind these.
    fn append(&mut self, other: &mut Self) {
        let (row, block, y) = (self.rows.len(), self.blocks.len(), self.y.len());
        self.y.extend_from_slice(&other.y);
        for mut new in other.rows.drain(..) {
            new.y += y;
            self.rows.push(new);
        }
        for mut new in other.blocks.drain(..) {
            new.rows.start += row;
            self.blocks.push(new);
        }
        for mut new in other.anchors.drain(..) {
            new.block += block;
            self.anchors.push(new);
        }
        self.unrecovered = self.unrecovered.max(other.unrecovered);
    }
}
