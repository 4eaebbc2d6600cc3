//! Functions that code calls: sine and cosine, the angle of a point, power, of all lanes.
#![allow(unsafe_code)]
#![cfg(target_arch = "x86_64")]

use super::isa::Isa;
use crate::real::elementary::{atan2_each, pow_each, sin_cos_each};

macro_rules! functions {
    ($module:ident, $number:ty, $width:literal) => {
        mod $module {
            use super::*;

            type Lanes = [$number; $width];

            pub extern "sysv64" fn sin_cos(read: *const Lanes, left: *mut Lanes) {
                // SAFETY: code calls this with what `Assembler::call` says: vectors to read and to write.
                unsafe {
                    let (sin, cos) = sin_cos_each(&(*read).map(f64::from));
                    *left = sin.map(|x| x as $number);
                    *left.add(1) = cos.map(|x| x as $number);
                }
            }

            pub extern "sysv64" fn atan2(read: *const Lanes, left: *mut Lanes) {
                // SAFETY: as above.
                unsafe {
                    let (y, x) = ((*read).map(f64::from), (*read.add(1)).map(f64::from));
                    *left = atan2_each(&y, &x).map(|x| x as $number);
                }
            }

            pub extern "sysv64" fn pow(read: *const Lanes, left: *mut Lanes) {
                // SAFETY: as above.
                unsafe {
                    let (x, y) = ((*read).map(f64::from), (*read.add(1)).map(f64::from));
                    *left = pow_each(&x, &y).map(|x| x as $number);
                }
            }

            pub fn all() -> [usize; 3] {
                [
                    sin_cos as *const () as usize,
                    atan2 as *const () as usize,
                    pow as *const () as usize,
                ]
            }
        }
    };
}
functions!(f64x4, f64, 4);
functions!(f64x8, f64, 8);
functions!(f32x8, f32, 8);
functions!(f32x16, f32, 16);

/// Their addresses, in the order of `Function`.
pub(super) fn of(isa: Isa) -> [usize; 3] {
    match (isa.wide, isa.single) {
        (false, false) => f64x4::all(),
        (true, false) => f64x8::all(),
        (false, true) => f32x8::all(),
        (true, true) => f32x16::all(),
    }
}
