//! Contacts that slide along two tangents, whose pyramids are made together: the contacts of two free
//! boxes, often four, share bodies, directions, material and most terms of their rows.

use super::contact::{axes_of, bodies};
use super::friction::Ways;
use crate::detect::Contact;
use crate::interrupt::{Meter, TEST};
use crate::real::{Constant, Mask, Real, Value};
use crate::settings::{Cone, Law};
use crate::solve::law::Spring;
use crate::solve::{Rows, Situation};

impl<R: Real> Rows<R> {
    /// Makes MuJoCo's contacts. Contacts of one pair are adjacent, and are made by fours and twos if
    /// their directions are the same.
    pub(super) fn soft_contacts(&mut self, now: &Situation<R>, contacts: &[Contact<R>]) {
        let mut meter = Meter::default();
        for own in contacts.chunk_by(|a, b| a.pair.index == b.pair.index) {
            meter.count(TEST * own.len());
            let rest = self.by_pyramids::<4>(now, own);
            for contact in self.by_pyramids::<2>(now, rest) {
                self.soft_contact(now, contact);
            }
        }
    }

    /// Makes contacts of one pair N at a time, and returns the rest.
    fn by_pyramids<'a, const N: usize>(
        &mut self,
        now: &Situation<R>,
        mut contacts: &'a [Contact<R>],
    ) -> &'a [Contact<R>] {
        while let Some((own, rest)) = contacts.split_first_chunk::<N>() {
            // Lanes have their vectors already.
            if !R::ALONE || !self.pyramids(now, own) {
                own.iter().for_each(|contact| self.soft_contact(now, contact));
            }
            contacts = rest;
        }
        contacts
    }

    /// Makes the edges of contacts of one pair that slide along the same two tangents and no more,
    /// together; false: nothing is made.
    pub(super) fn pyramids<const N: usize>(
        &mut self,
        now: &Situation<R>,
        contacts: &[Contact<R>; N],
    ) -> bool {
        let (first, settings) = (&contacts[0], now.settings);
        let (pair, material) = (&first.pair, now.model.material(&first.pair));
        let limited = settings.max_recovery_speed.under(Law::SolRef).is_some();
        let slides = material.condim == 3 && pair.still == [false; 2];
        let plain = slides && !material.adhesion.is_positive() && !pair.invweight.is_zero();
        if settings.cone != Cone::Pyramidal || !plain || limited {
            return false;
        }
        let ways = Ways::<R>::soft(pair.still, material);
        let [one, two] = ways.list() else { return false };
        let reach: R = material.reach();
        let masks = contacts.each_ref().map(|contact| contact.mask.and(contact.dist.lt(reach)));
        let alike = |contact: &Contact<R>| contact.normal == first.normal;
        if !masks.iter().all(|mask| mask.any()) || !contacts[1..].iter().all(alike) {
            return false;
        }
        let axis = axes_of(first, now);
        let (along, mu) = ([first.normal, axis(one), axis(two)], ways.mu);
        let (own, at) = ((bodies(now.model, pair), pair), contacts.each_ref().map(Contact::points));
        let Some(made) = self.lift_pyramids(now, own, &at, &along, mu) else { return false };
        let spring = Spring::new(&material.soft, settings.dt, settings.refsafe);
        let nothing = (R::Mask::of(false), [R::zero(); 2]);
        for (which, (contact, mask)) in contacts.iter().zip(masks).enumerate() {
            let (row, r) = (self.rows.len(), contact.dist - material.margin.get());
            self.push_pyramid(&made, which, pair, mu);
            let law = (spring.at(r), r, nothing.0, nothing.1);
            self.fill_pyramid(now, contact, (row, &ways), law, mask);
        }
        true
    }
}
