//! A snapshot as bytes: the arrays of one world and what a step hands to the next.

use stepcore::arrays::Given;
use stepcore::state::{Warm, WARM_ROWS};

use crate::world::Memo;

/// First bytes of a snapshot; the number goes up when the layout changes.
const HEAD: &[u8; 16] = b"stepcore state 4";

/// Steps are counted in numbers that hold every one of them.
const MOST_STEPS: u64 = 1 << 53;

/// What a snapshot holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    pub dt: f64,
    pub memo: Memo,
    /// qpos, qvel, ctrl, qfrc_applied, xfrc_applied one after the other.
    pub numbers: Vec<f64>,
}

impl Snapshot {
    /// Counts time in steps of `dt`; where the snapshot's were others, it goes on from there.
    pub fn count_in(&mut self, dt: f64) {
        if self.dt != dt {
            self.memo.start += self.memo.steps as f64 * self.dt;
            (self.memo.steps, self.dt) = (0, dt);
        }
    }
}

pub fn encode(dt: f64, memo: &Memo, given: &Given) -> Vec<u8> {
    let arrays = [given.qpos, given.qvel, given.ctrl, given.qfrc_applied, given.xfrc_applied];
    let mut bytes = HEAD.to_vec();
    for array in arrays {
        bytes.extend((array.len() as u64).to_le_bytes());
    }
    bytes.extend((memo.warm.len() as u64).to_le_bytes());
    bytes.extend(memo.steps.to_le_bytes());
    let warm = memo.warm.iter().flat_map(|w| w.impulse.into_iter().chain([w.feature]));
    for number in
        [dt, memo.start].into_iter().chain(arrays.into_iter().flatten().copied()).chain(warm)
    {
        bytes.extend(number.to_le_bytes());
    }
    for warm in &memo.warm {
        bytes.extend(warm.slot.to_le_bytes());
    }
    bytes.extend(checksum(&bytes).to_le_bytes());
    bytes
}

/// FNV-1a, 64 bits: every damage to a single byte changes it.
fn checksum(bytes: &[u8]) -> u64 {
    let mix = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3);
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, mix)
}

/// The snapshot in `bytes`, or what is wrong with them.
pub fn decode(bytes: &[u8], lengths: [usize; 5]) -> Result<Snapshot, String> {
    const NONE: &str = "these are not the bytes of a state() of this version";
    const CHANGED: &str = "the bytes of this state() were changed";
    let (bytes, sum) = bytes.split_last_chunk().ok_or(NONE)?;
    let mut rest = bytes.strip_prefix(HEAD.as_slice()).ok_or(NONE)?;
    if checksum(bytes) != u64::from_le_bytes(*sum) {
        return Err(CHANGED.into());
    }
    let mut next = |count: usize| {
        let (head, tail) =
            rest.split_at_checked(count).ok_or("the bytes of this state() are cut short")?;
        rest = tail;
        Ok::<_, &str>(head)
    };
    fn word(bytes: &[u8]) -> [u8; 8] {
        let mut word = [0; 8];
        word.copy_from_slice(bytes);
        word
    }
    for (name, length) in ["nq", "nv", "nu", "nv", "6 nbody"].iter().zip(lengths) {
        let theirs = u64::from_le_bytes(word(next(8)?));
        if theirs != length as u64 {
            return Err(format!(
                "this state() is of another model: {name} is {theirs} there, {length} here"
            ));
        }
    }
    let count = u64::from_le_bytes(word(next(8)?));
    let steps = u64::from_le_bytes(word(next(8)?));
    let total = lengths.iter().sum::<usize>();
    let mut numbers = |count: usize| -> Result<Vec<f64>, String> {
        let bytes = next(count.checked_mul(8).ok_or("a list in this state() is too long")?)?;
        Ok(bytes.chunks_exact(8).map(|chunk| f64::from_le_bytes(word(chunk))).collect())
    };
    let clock = numbers(2)?;
    let arrays = numbers(total)?;
    let count = usize::try_from(count).map_err(|e| e.to_string())?;
    let impulses =
        numbers(count.checked_mul(WARM_ROWS + 1).ok_or("a list in this state() is too long")?)?;
    let slots = next(count * 8)?;
    let mut warm = Vec::with_capacity(count);
    for (slot, numbers) in slots.chunks_exact(8).zip(impulses.chunks_exact(WARM_ROWS + 1)) {
        let slot = u64::from_le_bytes(word(slot));
        let impulse = std::array::from_fn(|k| numbers[k]);
        warm.push(Warm { slot, feature: numbers[WARM_ROWS], impulse });
    }
    let [dt, start] = [clock[0], clock[1]];
    let ascending = warm.windows(2).all(|w| w[0].slot < w[1].slot);
    let counted = steps <= MOST_STEPS && dt > 0.0 && (start + steps as f64 * dt).is_finite();
    if !rest.is_empty() || !ascending || !counted || !impulses.iter().all(|x| x.is_finite()) {
        return Err(CHANGED.into());
    }
    Ok(Snapshot { dt, memo: Memo { start, steps, warm }, numbers: arrays })
}
