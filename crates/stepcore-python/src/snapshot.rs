//! A snapshot as bytes: the arrays of one world and what a step hands to the next.

use stepcore::arrays::{Array, Given};
use stepcore::model::NONE;
use stepcore::real::{Mask, Real};
use stepcore::warm::Sleep;
use stepcore::warm::{Warm, WARM_ROWS};

use crate::world::Memo;

/// First bytes of a snapshot; the number goes up when the layout changes.
const HEAD: &[u8; 16] = b"stepcore state 9";

/// Bytes of a word.
const WORD: usize = size_of::<u64>();

/// Steps are counted in numbers that hold every one of them.
const MOST_STEPS: u64 = 1 << 53;

/// What a snapshot holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    pub dt: f64,
    pub memo: Memo,
    /// Those of `Array::ALL` one after the other.
    pub numbers: Vec<f64>,
}

impl Snapshot {
    /// Counts time in steps of `dt`; where the snapshot's were others, it goes on from there.
    pub fn count_in(&mut self, dt: f64) {
        if self.dt != dt {
            self.memo.start += self.memo.steps as f64 * self.dt;
            (self.memo.steps, self.dt) = (0, dt);
            self.memo.wake();
        }
    }
}

pub fn encode(dt: f64, memo: &Memo, given: &Given) -> Vec<u8> {
    let arrays = *given.lists();
    let mut bytes = HEAD.to_vec();
    for array in arrays {
        bytes.extend((array.len() as u64).to_le_bytes());
    }
    bytes.extend((memo.warm.len() as u64).to_le_bytes());
    bytes.extend(memo.steps.to_le_bytes());
    let numbers = [dt, memo.start].into_iter().chain(arrays.into_iter().flatten().copied());
    numbers.for_each(|number| bytes.extend(number.to_le_bytes()));
    memo.warm.iter().for_each(|warm| encode_warm(&mut bytes, warm));
    let sleep = &memo.sleep;
    for count in [sleep.slow.len(), sleep.qpos.len(), sleep.kept.len()] {
        bytes.extend((count as u64).to_le_bytes());
    }
    for (slow, island) in sleep.slow.iter().zip(&sleep.island) {
        bytes.extend(slow.to_le_bytes());
        bytes.extend((*island as u64).to_le_bytes());
    }
    sleep.qpos.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
    for (island, warm) in &sleep.kept {
        bytes.extend((*island as u64).to_le_bytes());
        encode_warm(&mut bytes, warm);
    }
    bytes.extend(checksum(&bytes).to_le_bytes());
    bytes
}

/// An impulse of a snapshot; that of an f64 world may be no number in f32, and is then none.
pub fn impulse<R: Real>(x: f64) -> f64 {
    if R::of(x).is_finite().all() {
        x
    } else {
        0.0
    }
}

fn encode_warm(bytes: &mut Vec<u8>, warm: &Warm<f64>) {
    bytes.extend(warm.slot.to_le_bytes());
    for number in warm.impulse.into_iter().chain([warm.feature]) {
        bytes.extend(number.to_le_bytes());
    }
}

/// Word after word by a rotation, an exclusive or and a product with an odd number (FxHash), each of
/// which can be undone: every damage within one word changes it.
fn checksum(bytes: &[u8]) -> u64 {
    let mix =
        |hash: u64, word: u64| (hash.rotate_left(5) ^ word).wrapping_mul(0x517c_c1b7_2722_0a95);
    let (mut words, mut last) = (bytes.chunks_exact(WORD), [0; WORD]);
    let word = |bytes: &[u8]| bytes.try_into().map_or(0, u64::from_le_bytes);
    let hash = words.by_ref().map(word).fold(bytes.len() as u64, mix);
    last[..words.remainder().len()].copy_from_slice(words.remainder());
    mix(hash, u64::from_le_bytes(last))
}

/// The snapshot in `bytes`, or what is wrong with them.
pub fn decode(bytes: &[u8], lengths: [usize; Array::COUNT]) -> Result<Snapshot, String> {
    const OTHER: &str = "these are not the bytes of a state() of this version";
    const CHANGED: &str = "the bytes of this state() were changed";
    let (bytes, sum) = bytes.split_last_chunk().ok_or(OTHER)?;
    let rest = bytes.strip_prefix(HEAD.as_slice()).ok_or(OTHER)?;
    if checksum(bytes) != u64::from_le_bytes(*sum) {
        return Err(CHANGED.into());
    }
    let mut rest = Rest(rest);
    for (array, length) in Array::ALL.into_iter().zip(lengths) {
        let name = array.length();
        let theirs = rest.word()?;
        if theirs != length as u64 {
            return Err(format!(
                "this state() is of another model: {name} is {theirs} there, {length} here"
            ));
        }
    }
    let (count, steps) = (rest.word()?, rest.word()?);
    let (dt, start) = (rest.number()?, rest.number()?);
    let total = lengths.iter().sum::<usize>();
    let numbers = (0..total).map(|_| rest.number()).collect::<Result<_, _>>()?;
    let warm = rest.list(count, Rest::warm)?;
    let sleep = rest.sleep(lengths[0])?;
    let ascending = warm.windows(2).all(|w| w[0].slot < w[1].slot);
    let counted = steps <= MOST_STEPS && dt > 0.0 && (start + steps as f64 * dt).is_finite();
    let mut all = warm.iter().chain(sleep.kept.iter().map(|(_, warm)| warm));
    let finite = all.all(|w| w.feature.is_finite() && w.impulse.iter().all(|x| x.is_finite()));
    if !rest.0.is_empty() || !ascending || !counted || !finite {
        return Err(CHANGED.into());
    }
    Ok(Snapshot { dt, memo: Memo { start, steps, warm, sleep }, numbers })
}

/// What is still to be read.
struct Rest<'a>(&'a [u8]);

impl Rest<'_> {
    fn word(&mut self) -> Result<u64, String> {
        let cut = || "the bytes of this state() are cut short".to_string();
        let (word, rest) = self.0.split_first_chunk().ok_or_else(cut)?;
        self.0 = rest;
        Ok(u64::from_le_bytes(*word))
    }

    fn number(&mut self) -> Result<f64, String> {
        self.word().map(f64::from_bits)
    }

    /// As many as were counted, each of at least one word.
    fn list<T>(
        &mut self,
        count: u64,
        one: impl Fn(&mut Self) -> Result<T, String>,
    ) -> Result<Vec<T>, String> {
        if count > self.0.len() as u64 / 8 {
            return Err("a list in this state() is too long".into());
        }
        (0..count).map(|_| one(self)).collect()
    }

    fn warm(&mut self) -> Result<Warm<f64>, String> {
        let slot = self.word()?;
        let mut impulse = [0.0; WARM_ROWS];
        for number in &mut impulse {
            *number = self.number()?;
        }
        Ok(Warm { slot, feature: self.number()?, impulse })
    }

    /// A tree's index, or `NONE`.
    fn island(&mut self, trees: u64) -> Result<usize, String> {
        let island = self.word()?;
        if island >= trees && island != NONE as u64 {
            return Err("an island in this state() has no tree".into());
        }
        Ok(island as usize)
    }

    fn sleep(&mut self, nq: usize) -> Result<Sleep<f64>, String> {
        let (trees, places, kept) = (self.word()?, self.word()?, self.word()?);
        if (trees == 0) != (places == 0) || places != 0 && places != nq as u64 {
            return Err("this state() is of another model: who sleeps does not fit".into());
        }
        let both = self.list(trees, |rest| Ok((rest.word()?, rest.island(trees)?)))?;
        let (slow, island) = both.into_iter().unzip();
        Ok(Sleep {
            slow,
            island,
            qpos: self.list(places, Self::number)?,
            kept: self.list(kept, |rest| Ok((rest.island(trees)?, rest.warm()?)))?,
        })
    }
}
