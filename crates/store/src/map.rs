//! Sealed, uncompressed extents in place: a map that is brought in and checked before anyone sees it.
//!
//! This is the one file of the workspace with `unsafe` code (the two calls that keep the C allocator honest live
//! here for that reason). It rests on one rule: a sealed file is
//! never written, truncated or punched by this program. What another program may do to it is bounded
//! by care: the length is checked first, pages are brought in by a call that answers an I/O error
//! with an error instead of a signal, and the checksum is verified before the slice is handed out.
#![allow(unsafe_code)]

use std::fmt;
use std::io;
use std::ops::Deref;

use enf_layout::sections::Malformed;
use memmap2::{Advice, Mmap, MmapOptions};
use xxhash_rust::xxh3::Xxh3;
use zerocopy::{FromBytes, Immutable, KnownLayout};

use crate::budget;
use crate::dir::IoStats;
use crate::files::{Named, WINDOW};
use crate::load::{self, Extent};
use crate::{MemoryBudget, Reservation, StoreError};

/// Smallest page there is on the machines we know; maps begin on one.
const PAGE: u64 = 4096;

/// An extent's bytes, mapped; all of them are resident, counted in the budget, and verified.
pub struct Mapped {
    map: Mmap,
    len: usize,
    _reservation: Reservation,
}

impl Mapped {
    /// The bytes as a slice of records.
    ///
    /// # Errors
    /// When they are no whole number of records.
    pub fn as_slice_of<T: FromBytes + Immutable + KnownLayout>(&self) -> Result<&[T], Malformed> {
        budget::records(self)
    }
}

impl Deref for Mapped {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        &self.map[..self.len]
    }
}

impl fmt::Debug for Mapped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Mapped({} bytes)", self.len)
    }
}

/// Maps an extent of a sealed data file. The caller has checked that it is sealed and [`enf_layout::segment::Codec::Raw`].
pub(crate) fn map(
    data: &Named,
    extent: &Extent,
    budget: &MemoryBudget,
    what: &'static str,
    io: &IoStats,
) -> Result<Mapped, StoreError> {
    let file_len = data.len()?;
    let (Ok(len), Ok(padded)) =
        (usize::try_from(extent.stored_bytes), usize::try_from(extent.padded_bytes()))
    else {
        return Err(data.corrupt(extent.offset, "the extent does not fit in memory"));
    };
    if extent.end() > file_len {
        let detail = format!("the file ends here, {} bytes are expected", extent.end());
        return Err(data.corrupt(file_len, detail));
    }
    let first_page = extent.offset - extent.offset % PAGE;
    let pages = extent.end().next_multiple_of(PAGE) - first_page;
    let reservation = budget.reserve(pages, what)?;
    // SAFETY: the map is read-only, lies within the file's length, and the file is sealed: neither
    // this process nor another of this program changes or shortens a sealed file; deleting it
    // (`--force`) leaves the pages of those who have it open alone.
    let map = unsafe { MmapOptions::new().offset(extent.offset).len(padded).map(&data.file) }
        .map_err(StoreError::io("map", &data.path))?;
    let mut hash = Xxh3::new();
    let mut spare = Vec::new();
    for start in (0..padded).step_by(4 * WINDOW) {
        let window = start..(start + 4 * WINDOW).min(padded);
        if let Err(e) = map.advise_range(Advice::PopulateRead, window.start, window.len()) {
            if e.kind() != io::ErrorKind::InvalidInput {
                return Err(StoreError::io("read", &data.path)(e));
            }
            // A kernel before 5.14: plain reads bring the pages into the cache, and fail politely.
            spare.resize(64 << 10, 0);
            for at in window.clone().step_by(spare.len()) {
                let n = spare.len().min(window.end - at);
                data.read(extent.offset + at as u64, &mut spare[..n], &IoStats::default())?;
            }
        }
        hash.update(&map[window]);
    }
    io.read(padded as u64);
    load::check(data, extent, hash.digest128().to_le_bytes())?;
    Ok(Mapped { map, len, _reservation: reservation })
}

/// Tells the C allocator to serve blocks of 128 KiB and more by maps of their own, so that what is dropped leaves
/// the process at once, and to keep few arenas. A budget that the kernel measures cannot be kept otherwise: glibc
/// raises that threshold up to 32 MiB by itself. Does nothing on other C libraries.
pub fn tune_allocator() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: `mallopt` may be called at any time, from any thread; it takes two integers and keeps no pointer.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, 128 << 10);
        libc::mallopt(libc::M_TRIM_THRESHOLD, 128 << 10);
        libc::mallopt(libc::M_ARENA_MAX, 2);
    }
}

/// Hands free pages of the heap back to the kernel. Does nothing on other C libraries than glibc.
pub fn give_back_free_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: `malloc_trim` only touches memory that the allocator itself owns and nobody uses.
    unsafe {
        libc::malloc_trim(0);
    }
}
