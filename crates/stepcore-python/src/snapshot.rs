//! A snapshot as bytes: one world's arrays, the data passed to its next step, and the last solve.

use stepcore::arrays::{Array, Given};
use stepcore::batch::Last;
use stepcore::model::NONE;
use stepcore::warm::Sleep;
use stepcore::warm::{Warm, WARM_ROWS};

use crate::memo::{Memo, Solve};

/// First bytes of a snapshot; the last character goes up when the layout changes.
const HEAD: &[u8; 16] = b"stepcore state A";

/// Bytes of a word.
const WORD: usize = size_of::<u64>();

/// Up to here a float holds every step count.
const MOST_STEPS: u64 = 1 << 53;

/// The content of a snapshot.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    pub dt: f64,
    pub memo: Memo,
    /// In a batch all worlds count time together, in addition to each world's time.
    pub shared: Clock,
    /// The arrays of `Array::ALL` one after the other.
    pub numbers: Vec<f64>,
}

/// Time is `start` + `steps` · dt.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clock {
    pub start: f64,
    pub steps: u64,
}

impl Clock {
    /// Expresses the same time in steps of another length.
    fn count_from_now(&mut self, dt: f64) {
        self.start += self.steps as f64 * dt;
        self.steps = 0;
    }
}

impl Snapshot {
    /// Counts time in steps of `dt`; if the snapshot's were others, it continues from there.
    pub fn count_in(&mut self, dt: f64) {
        if self.dt != dt {
            let mut own = self.memo.clock();
            own.count_from_now(self.dt);
            self.shared.count_from_now(self.dt);
            self.memo.set_clock(own);
            self.dt = dt;
            self.memo.wake();
        }
    }
}

/// shared: the time that a batch's worlds share, if this world's differs.
pub fn encode(dt: f64, memo: &Memo, shared: Option<Clock>, given: &Given) -> Vec<u8> {
    let arrays = *given.lists();
    let mut bytes = HEAD.to_vec();
    arrays.iter().for_each(|array| put_word(&mut bytes, array.len() as u64));
    let shared = shared.unwrap_or(memo.clock());
    put_numbers(&mut bytes, &[dt]);
    for clock in [memo.clock(), shared] {
        put_word(&mut bytes, clock.steps);
        put_numbers(&mut bytes, &[clock.start]);
    }
    arrays.iter().for_each(|array| put_numbers(&mut bytes, array));
    put_memo(&mut bytes, memo);
    put_word_of_sum(&mut bytes);
    bytes
}

/// The start of the last solve, as a snapshot, and its result.
pub fn encode_last(dt: f64, last: &Solve) -> Vec<u8> {
    let mut bytes = encode(dt, &last.memo, None, &last.given());
    put_numbers(&mut bytes, &last.qacc);
    put_word(&mut bytes, last.of as u64);
    put_word_of_sum(&mut bytes);
    bytes
}

fn put_word(bytes: &mut Vec<u8>, word: u64) {
    bytes.extend(word.to_le_bytes());
}

fn put_numbers(bytes: &mut Vec<u8>, numbers: &[f64]) {
    numbers.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
}

fn put_word_of_sum(bytes: &mut Vec<u8>) {
    let sum = checksum(bytes);
    put_word(bytes, sum);
}

/// Impulses, and the sleeping trees.
fn put_memo(bytes: &mut Vec<u8>, memo: &Memo) {
    put_word(bytes, memo.warm.len() as u64);
    memo.warm.iter().for_each(|warm| encode_warm(bytes, warm));
    let sleep = &memo.sleep;
    for count in [sleep.slow.len(), sleep.qpos.len(), sleep.kept.len()] {
        put_word(bytes, count as u64);
    }
    for (slow, island) in sleep.slow.iter().zip(&sleep.island) {
        put_word(bytes, *slow);
        put_word(bytes, *island as u64);
    }
    put_numbers(bytes, &sleep.qpos);
    for (island, warm) in &sleep.kept {
        put_word(bytes, *island as u64);
        encode_warm(bytes, warm);
    }
}

fn encode_warm(bytes: &mut Vec<u8>, warm: &Warm<f64>) {
    bytes.extend(warm.slot.to_le_bytes());
    for number in warm.impulse.into_iter().chain([warm.feature]) {
        bytes.extend(number.to_le_bytes());
    }
}

/// Word after word by a rotation, an exclusive or and a product with an odd number (FxHash), each
/// of which can be undone: every damage within one word changes it.
fn checksum(bytes: &[u8]) -> u64 {
    let mix =
        |hash: u64, word: u64| (hash.rotate_left(5) ^ word).wrapping_mul(0x517c_c1b7_2722_0a95);
    let (mut words, mut last) = (bytes.chunks_exact(WORD), [0; WORD]);
    let word = |bytes: &[u8]| bytes.try_into().map_or(0, u64::from_le_bytes);
    let hash = words.by_ref().map(word).fold(bytes.len() as u64, mix);
    last[..words.remainder().len()].copy_from_slice(words.remainder());
    mix(hash, u64::from_le_bytes(last))
}

const OTHER: &str = "these are not the bytes of a state() of this version";
const CHANGED: &str = "the bytes of this state() were changed";

/// Decodes the snapshot in `bytes`, or returns their error.
pub fn decode(bytes: &[u8], lengths: [usize; Array::COUNT]) -> Result<Snapshot, String> {
    let rest = bytes.strip_prefix(HEAD.as_slice()).ok_or(OTHER)?;
    let mut rest = Rest(checked(rest, bytes)?);
    for (array, length) in Array::ALL.into_iter().zip(lengths) {
        let name = array.length();
        let theirs = rest.word()?;
        if theirs != length as u64 {
            return Err(format!(
                "this state() is of another model: {name} is {theirs} there, {length} here"
            ));
        }
    }
    let dt = rest.number()?;
    let (own, shared) = (rest.clock()?, rest.clock()?);
    let numbers = rest.numbers(lengths.iter().sum())?;
    let memo = rest.memo(lengths[0], own)?;
    let counted = |clock: Clock| {
        clock.steps <= MOST_STEPS && (clock.start + clock.steps as f64 * dt).is_finite()
    };
    let sound = is_sound(&memo) && dt > 0.0 && counted(own) && counted(shared);
    if !(rest.0.is_empty() && sound) {
        return Err(CHANGED.into());
    }
    Ok(Snapshot { dt, memo, shared, numbers })
}

/// The last solve of `encode_last`.
pub fn decode_last(bytes: &[u8], lengths: [usize; Array::COUNT]) -> Result<Solve, String> {
    let nv = lengths[Array::Qvel as usize];
    let end = checked(bytes, bytes)?;
    let (state, result) =
        end.split_at_checked(end.len().wrapping_sub((nv + 1) * WORD)).ok_or(OTHER)?;
    let Snapshot { memo, numbers, .. } = decode(state, lengths)?;
    let mut rest = Rest(result);
    let qacc = rest.numbers(nv)?;
    let of = if rest.word()? == Last::Step as u64 { Last::Step } else { Last::Forward };
    let mut numbers = numbers.into_iter();
    let lists = lengths.iter().map(|length| numbers.by_ref().take(*length).collect()).collect();
    Ok(Solve { of, qacc, lists, memo })
}

/// `part` of `bytes` without the checksum of all, which must be right.
fn checked<'a>(part: &'a [u8], bytes: &[u8]) -> Result<&'a [u8], String> {
    let (all, sum) = bytes.split_last_chunk().ok_or(OTHER)?;
    if checksum(all) != u64::from_le_bytes(*sum) {
        return Err(CHANGED.into());
    }
    part.get(..part.len() - WORD).ok_or(OTHER.into())
}

/// Whether its impulses are finite and in order.
fn is_sound(memo: &Memo) -> bool {
    let mut all = memo.warm.iter().chain(memo.sleep.kept.iter().map(|(_, warm)| warm));
    memo.warm.windows(2).all(|w| w[0].slot < w[1].slot)
        && all.all(|w| w.feature.is_finite() && w.impulse.iter().all(|x| x.is_finite()))
}

/// The bytes that are still to be read.
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

    fn numbers(&mut self, count: usize) -> Result<Vec<f64>, String> {
        (0..count).map(|_| self.number()).collect()
    }

    fn clock(&mut self) -> Result<Clock, String> {
        Ok(Clock { steps: self.word()?, start: self.number()? })
    }

    fn memo(&mut self, nq: usize, Clock { start, steps }: Clock) -> Result<Memo, String> {
        let count = self.word()?;
        let warm = self.list(count, Self::warm)?;
        Ok(Memo { start, steps, warm, sleep: self.sleep(nq)? })
    }

    /// As many items as were counted, each of at least one word.
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
