//! How much memory a world holds beside its own struct: the room of all its lists; and whether
//! there is as much.

use std::hint::black_box;

/// Whether the memory has so many bytes. The black box has them used: the optimiser may leave out
/// memory that nobody uses, and then never asks for it.
pub(crate) fn can_be_had(bytes: usize) -> bool {
    let mut room = Vec::<u8>::new();
    room.try_reserve_exact(bytes).is_ok() && black_box(&mut room).capacity() >= bytes
}

/// Bytes on the heap.
pub(crate) trait Room {
    fn room(&self) -> usize;
}

/// Of a list of plain numbers.
pub(crate) fn listed<T>(list: &Vec<T>) -> usize {
    list.capacity() * size_of::<T>()
}

impl<T: Room> Room for Vec<T> {
    fn room(&self) -> usize {
        listed(self) + self.iter().map(Room::room).sum::<usize>()
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

/// `Room` of a struct: its lists of plain numbers; then what has a `Room` of its own.
macro_rules! room {
    ($type:ident<R>: $($list:ident),*; $($part:ident),*) => {
        impl<R: crate::real::Real> crate::room::Room for $type<R> {
            fn room(&self) -> usize {
                0 $(+ crate::room::listed(&self.$list))* $(+ self.$part.room())*
            }
        }
    };
    ($type:ident: $($list:ident),* $(; $($part:ident),*)?) => {
        impl crate::room::Room for $type {
            fn room(&self) -> usize {
                0 $(+ crate::room::listed(&self.$list))* $($(+ self.$part.room())*)?
            }
        }
    };
}
pub(crate) use room;
