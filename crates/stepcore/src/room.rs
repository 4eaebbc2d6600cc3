//! The memory of a world outside its struct (all its lists), and whether that much is available.

use std::hint::black_box;
use std::sync::Arc;

/// Returns whether this many bytes can be allocated. The black box makes them used: the optimiser
/// may omit memory that is never used, and then never allocates it.
pub(crate) fn can_be_had(bytes: usize) -> bool {
    let mut room = Vec::<u8>::new();
    room.try_reserve_exact(bytes).is_ok() && black_box(&mut room).capacity() >= bytes
}

/// Bytes on the heap.
pub(crate) trait Room {
    fn room(&self) -> usize;
}

/// Bytes of a list whose items hold none on the heap.
pub(crate) fn listed<T>(list: &Vec<T>) -> usize {
    const { assert!(!std::mem::needs_drop::<T>()) }
    list.capacity() * size_of::<T>()
}

impl<T: Room> Room for Vec<T> {
    fn room(&self) -> usize {
        self.capacity() * size_of::<T>() + self.iter().map(Room::room).sum::<usize>()
    }
}

impl<T: Room + ?Sized> Room for Box<T> {
    fn room(&self) -> usize {
        size_of_val(&**self) + (**self).room()
    }
}

impl<T: Room> Room for Option<T> {
    fn room(&self) -> usize {
        self.as_ref().map_or(0, Room::room)
    }
}

impl<T, const N: usize> Room for [Vec<T>; N] {
    fn room(&self) -> usize {
        self.iter().map(listed).sum()
    }
}

/// Shared data are counted by their owner.
impl<T: ?Sized> Room for Arc<T> {
    fn room(&self) -> usize {
        0
    }
}

/// The bytes of a struct's field on the heap, by the first method that its type has: its `Room`;
/// the capacity of a list whose items hold nothing; zero, if nothing is to drop.
pub(crate) trait Bytes {
    fn bytes(self) -> usize;
}

pub(crate) struct Field<'a, T>(pub &'a T);

impl<T: Room> Bytes for &&&Field<'_, T> {
    fn bytes(self) -> usize {
        self.0.room()
    }
}

impl<T> Bytes for &&Field<'_, Vec<T>> {
    fn bytes(self) -> usize {
        listed(self.0)
    }
}

impl<T> Bytes for &Field<'_, T> {
    fn bytes(self) -> usize {
        const { assert!(!std::mem::needs_drop::<T>()) }
        0
    }
}

/// `Room` of a struct, whose every field is named: first the counted ones, then the others. A
/// missing field does not compile, nor does one that may hold uncounted memory.
macro_rules! room {
    ($type:ident<R $(, $n:ident)*>: $($field:ident),* $(; $($(#[$a:meta])? $not:ident),*)?) => {
        impl<R: crate::real::Real $(, const $n: usize)*> crate::room::Room for $type<R $(, $n)*> {
            room!(@ $($field)*; $($($(#[$a])? $not)*)?);
        }
    };
    ($type:ident: $($field:ident),* $(; $($(#[$a:meta])? $not:ident),*)?) => {
        impl crate::room::Room for $type {
            room!(@ $($field)*; $($($(#[$a])? $not)*)?);
        }
    };
    (@ $($field:ident)*; $($(#[$a:meta])? $not:ident)*) => {
        fn room(&self) -> usize {
            use crate::room::Bytes;
            let Self { $($field,)* $($(#[$a])? $not: _,)* } = self;
            0 $(+ (&&&crate::room::Field($field)).bytes())*
        }
    };
}
