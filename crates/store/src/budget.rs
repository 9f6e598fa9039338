//! One purse for all large memory: reserve first, allocate second, let drop give back.
//!
//! [`MemoryBudget`] counts; [`Reservation`] is a receipt; [`Buffer`] and [`Array`] are bytes and
//! records that carry their receipt with them. Whoever is refused hears who holds the rest.

use std::fmt;
use std::io;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use enf_layout::sections::Malformed;
use memmap2::{MmapMut, MmapOptions};
use parking_lot::Mutex;
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

/// The source of all large memory of a process. Cloning gives another handle to the same budget.
#[derive(Clone)]
pub struct MemoryBudget(Arc<Inner>);

struct Inner {
    limit: u64,
    /// Changed only under the lock of `holders`, read without.
    reserved: AtomicU64,
    peak: AtomicU64,
    /// In order of first appearance. A few dozen entries.
    holders: Mutex<Vec<Holder>>,
}

struct Holder {
    what: &'static str,
    /// Bytes held now.
    now: u64,
    /// Bytes held when the most was reserved in all.
    at_peak: u64,
}

impl MemoryBudget {
    /// A budget of `limit` bytes.
    pub fn new(limit: u64) -> Self {
        Self(Arc::new(Inner {
            limit,
            reserved: AtomicU64::new(0),
            peak: AtomicU64::new(0),
            holders: Mutex::new(Vec::new()),
        }))
    }

    /// Bytes that may be reserved in all.
    pub fn limit(&self) -> u64 {
        self.0.limit
    }

    /// Bytes reserved now.
    pub fn reserved(&self) -> u64 {
        self.0.reserved.load(Ordering::Relaxed)
    }

    /// Most bytes that were ever reserved at once.
    pub fn peak(&self) -> u64 {
        self.0.peak.load(Ordering::Relaxed)
    }

    /// Bytes that are free now. Another thread may take them before you do: [`reserve`](Self::reserve)
    /// is the only promise.
    pub fn available(&self) -> u64 {
        self.0.limit.saturating_sub(self.reserved())
    }

    /// Reserves `bytes` for `what` (a few words, such as "grid of a tile"), all or nothing.
    ///
    /// # Errors
    /// When fewer bytes are free; the error lists who holds the others.
    pub fn reserve(&self, bytes: u64, what: &'static str) -> Result<Reservation, BudgetError> {
        self.take(bytes, what)?;
        Ok(Reservation { budget: self.clone(), bytes, what })
    }

    /// Who holds how many bytes now, largest first, equals by name. Names that hold nothing are left out.
    pub fn holders(&self) -> Vec<(&'static str, u64)> {
        self.list(|holder| holder.now)
    }

    /// Who held how many bytes when [`peak`](Self::peak) was reached, in the same order.
    pub fn peak_holders(&self) -> Vec<(&'static str, u64)> {
        self.list(|holder| holder.at_peak)
    }

    fn list(&self, bytes: impl Fn(&Holder) -> u64) -> Vec<(&'static str, u64)> {
        let mut list: Vec<_> = self.0.holders.lock().iter().map(|h| (h.what, bytes(h))).collect();
        list.retain(|h| h.1 > 0);
        list.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(b.0)));
        list
    }

    fn take(&self, bytes: u64, what: &'static str) -> Result<(), BudgetError> {
        let mut holders = self.0.holders.lock();
        let now = self.reserved();
        let Some(after) = now.checked_add(bytes).filter(|&after| after <= self.0.limit) else {
            drop(holders);
            return Err(self.refusal(bytes, what, self.0.limit.saturating_sub(now)));
        };
        match holders.iter_mut().find(|h| h.what == what) {
            Some(holder) => holder.now += bytes,
            None => holders.push(Holder { what, now: bytes, at_peak: 0 }),
        }
        self.0.reserved.store(after, Ordering::Relaxed);
        if after > self.peak() {
            self.0.peak.store(after, Ordering::Relaxed);
            holders.iter_mut().for_each(|h| h.at_peak = h.now);
        }
        Ok(())
    }

    fn give_back(&self, bytes: u64, what: &'static str) {
        let mut holders = self.0.holders.lock();
        if let Some(holder) = holders.iter_mut().find(|h| h.what == what) {
            holder.now -= bytes;
        }
        self.0.reserved.store(self.reserved() - bytes, Ordering::Relaxed);
    }

    fn refusal(&self, needed: u64, what: &'static str, available: u64) -> BudgetError {
        BudgetError { what, needed, available, limit: self.0.limit, holders: self.holders() }
    }
}

impl fmt::Debug for MemoryBudget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MemoryBudget")
            .field("limit", &self.limit())
            .field("reserved", &self.reserved())
            .field("holders", &self.holders())
            .finish()
    }
}

/// A reservation that was refused.
///
/// When `needed <= available`, it was the operating system that refused the memory, not the budget.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BudgetError {
    /// What the bytes were for.
    pub what: &'static str,
    /// Bytes asked for.
    pub needed: u64,
    /// Bytes that were free.
    pub available: u64,
    /// The whole budget, bytes.
    pub limit: u64,
    /// Who held the rest, largest first.
    pub holders: Vec<(&'static str, u64)>,
}

impl fmt::Display for BudgetError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (mut needed, mut free) = (format_bytes(self.needed), format_bytes(self.available));
        if needed == free {
            (needed, free) = (format!("{} B", self.needed), format!("{} B", self.available));
        }
        let limit = format_bytes(self.limit);
        write!(f, "{} needs {needed}, {free} of {limit} are free", self.what)?;
        if self.needed <= self.available {
            f.write_str(", but the operating system refuses the memory")?;
        }
        for (i, (what, bytes)) in self.holders.iter().take(4).enumerate() {
            let lead = if i == 0 { " (largest holders: " } else { ", " };
            write!(f, "{lead}{what} {}", format_bytes(*bytes))?;
        }
        if self.holders.is_empty() { Ok(()) } else { f.write_str(")") }
    }
}

impl std::error::Error for BudgetError {}

/// Bytes as people read them, in powers of 1024: `900 B`, `64.0 KiB`, `1.5 MiB`, `175 MiB`, `12.0 GiB`.
pub fn format_bytes(bytes: u64) -> String {
    let (mut value, mut unit) = (bytes as f64, "B");
    for next in ["KiB", "MiB", "GiB", "TiB"] {
        if value < 1024.0 {
            break;
        }
        (value, unit) = (value / 1024.0, next);
    }
    match unit {
        "B" => format!("{bytes} B"),
        _ if value < 100.0 => format!("{value:.1} {unit}"),
        _ => format!("{value:.0} {unit}"),
    }
}

/// The receipt for reserved bytes. Dropping it gives them back.
#[derive(Debug)]
pub struct Reservation {
    budget: MemoryBudget,
    bytes: u64,
    what: &'static str,
}

impl Reservation {
    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Changes the reservation to `bytes` in all.
    ///
    /// # Errors
    /// When it grows by more than is free; it then stays as it was.
    pub fn resize(&mut self, bytes: u64) -> Result<(), BudgetError> {
        if bytes > self.bytes {
            self.budget.take(bytes - self.bytes, self.what)?;
        } else {
            self.budget.give_back(self.bytes - bytes, self.what);
        }
        self.bytes = bytes;
        Ok(())
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.budget.give_back(self.bytes, self.what);
    }
}

/// 64 bytes on a 64-byte boundary.
#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
struct Line([u8; 64]);

/// From this size on a [`Buffer`] has pages of its own, which go back to the system at once when it
/// is dropped, instead of a place in the allocator's heap, which may keep them.
const OWN_PAGES: usize = 128 << 10;

enum Storage {
    Lines(Vec<Line>),
    Pages(MmapMut),
}

/// Zeroed bytes of a fixed length, 64-byte aligned, with their reservation.
///
/// The reservation is `len` bytes; what alignment and pages add (less than 64 bytes in a small
/// buffer, less than a page in a big one) is not counted.
pub struct Buffer {
    storage: Storage,
    len: usize,
    reservation: Reservation,
}

impl Buffer {
    /// Reserves and allocates `len` zero bytes for `what`.
    ///
    /// # Errors
    /// When the budget, or the operating system, has not got them.
    pub fn zeroed(
        budget: &MemoryBudget,
        len: usize,
        what: &'static str,
    ) -> Result<Self, BudgetError> {
        Self::new(budget, len, what, false)
    }

    /// Zero bytes all of which will be written at once: the system brings their pages in one go, at half the cost.
    ///
    /// # Errors
    /// When the budget, or the operating system, has not got them.
    pub(crate) fn to_fill(
        budget: &MemoryBudget,
        len: usize,
        what: &'static str,
    ) -> Result<Self, BudgetError> {
        Self::new(budget, len, what, true)
    }

    fn new(
        budget: &MemoryBudget,
        len: usize,
        what: &'static str,
        populate: bool,
    ) -> Result<Self, BudgetError> {
        let reservation = budget.reserve(len as u64, what)?;
        let lines = len.div_ceil(64).max(1);
        let storage = if len >= OWN_PAGES {
            let map = |bytes| {
                let mut options = MmapOptions::new();
                options.len(bytes);
                if populate {
                    options.populate();
                }
                options.map_anon()
            };
            lines
                .checked_mul(64)
                .ok_or(io::ErrorKind::OutOfMemory.into())
                .and_then(map)
                .map(Storage::Pages)
                .ok()
        } else {
            Line::new_vec_zeroed(lines).map(Storage::Lines).ok()
        };
        match storage {
            Some(storage) => Ok(Self { storage, len, reservation }),
            None => {
                let free = budget.available().saturating_add(len as u64);
                drop(reservation);
                Err(budget.refusal(len as u64, what, free))
            }
        }
    }

    /// A copy of `bytes`.
    ///
    /// # Errors
    /// When the budget, or the operating system, has not got them.
    pub fn copy_of(
        budget: &MemoryBudget,
        bytes: &[u8],
        what: &'static str,
    ) -> Result<Self, BudgetError> {
        let mut buffer = Self::zeroed(budget, bytes.len(), what)?;
        buffer.copy_from_slice(bytes);
        Ok(buffer)
    }

    /// The bytes as a slice of records.
    ///
    /// # Errors
    /// When they are no whole number of records.
    pub fn as_slice_of<T: FromBytes + Immutable + KnownLayout>(&self) -> Result<&[T], Malformed> {
        records(self)
    }

    /// The bytes as a mutable slice of records.
    ///
    /// # Errors
    /// When they are no whole number of records.
    pub fn as_mut_slice_of<T: FromBytes + IntoBytes + KnownLayout>(
        &mut self,
    ) -> Result<&mut [T], Malformed> {
        let len = self.len;
        <[T]>::mut_from_bytes(self).map_err(|_| no_whole_number::<T>(len))
    }

    /// Bytes reserved for it.
    pub fn reserved(&self) -> u64 {
        self.reservation.bytes()
    }

    /// The bytes and what follows them up to the next 64-byte boundary (64 bytes if there are none).
    pub(crate) fn padded_mut(&mut self) -> &mut [u8] {
        let padded = self.len.div_ceil(64).max(1) * 64;
        match &mut self.storage {
            Storage::Lines(lines) => &mut lines.as_mut_bytes()[..padded],
            Storage::Pages(pages) => &mut pages[..padded],
        }
    }
}

impl Deref for Buffer {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        match &self.storage {
            Storage::Lines(lines) => &lines.as_bytes()[..self.len],
            Storage::Pages(pages) => &pages[..self.len],
        }
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [u8] {
        let len = self.len;
        &mut self.padded_mut()[..len]
    }
}

impl fmt::Debug for Buffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Buffer({} bytes for {})", self.len, self.reservation.what)
    }
}

/// Any bytes as records; they must be aligned for `T`.
pub(crate) fn records<T: FromBytes + Immutable + KnownLayout>(
    bytes: &[u8],
) -> Result<&[T], Malformed> {
    <[T]>::ref_from_bytes(bytes).map_err(|_| no_whole_number::<T>(bytes.len()))
}

fn no_whole_number<T>(bytes: usize) -> Malformed {
    Malformed(format!("{bytes} bytes are no whole number of records of {} bytes", size_of::<T>()))
}

/// A vector that never grows by itself: its capacity is reserved and allocated once.
pub struct Array<T> {
    items: Vec<T>,
    capacity: usize,
    reservation: Reservation,
}

fn bytes_of<T>(n: usize) -> u64 {
    (n as u64).saturating_mul(size_of::<T>() as u64)
}

fn allocate<T>(
    budget: &MemoryBudget,
    n: usize,
    what: &'static str,
) -> Result<(Vec<T>, Reservation), BudgetError> {
    let reservation = budget.reserve(bytes_of::<T>(n), what)?;
    let mut items = Vec::new();
    match items.try_reserve_exact(n) {
        Ok(()) => Ok((items, reservation)),
        Err(_) => {
            let free = budget.available().saturating_add(reservation.bytes());
            drop(reservation);
            Err(budget.refusal(bytes_of::<T>(n), what, free))
        }
    }
}

impl<T> Array<T> {
    /// Reserves and allocates place for `n` items.
    ///
    /// # Errors
    /// When the budget, or the operating system, has not got the bytes.
    pub fn with_capacity(
        budget: &MemoryBudget,
        n: usize,
        what: &'static str,
    ) -> Result<Self, BudgetError> {
        let (items, reservation) = allocate(budget, n, what)?;
        Ok(Self { items, capacity: n, reservation })
    }

    /// Items that it has place for.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Whether a [`push`](Self::push) would be refused.
    pub fn is_full(&self) -> bool {
        self.items.len() == self.capacity
    }

    /// Appends an item.
    ///
    /// # Errors
    /// Gives it back when the array is full.
    pub fn push(&mut self, item: T) -> Result<(), T> {
        if self.is_full() {
            return Err(item);
        }
        self.items.push(item);
        Ok(())
    }

    /// Takes the last item off.
    pub fn pop(&mut self) -> Option<T> {
        self.items.pop()
    }

    /// Appends all items, or none.
    ///
    /// # Errors
    /// [`ArrayFull`] when there is not place for all of them.
    pub fn extend_from_slice(&mut self, items: &[T]) -> Result<(), ArrayFull>
    where
        T: Clone,
    {
        if items.len() > self.capacity - self.items.len() {
            return Err(ArrayFull { capacity: self.capacity });
        }
        self.items.extend_from_slice(items);
        Ok(())
    }

    /// Makes it `n` items long, with copies of `item` where it grows.
    ///
    /// # Errors
    /// [`ArrayFull`] when `n` is more than the capacity.
    pub fn resize(&mut self, n: usize, item: T) -> Result<(), ArrayFull>
    where
        T: Clone,
    {
        if n > self.capacity {
            return Err(ArrayFull { capacity: self.capacity });
        }
        self.items.resize(n, item);
        Ok(())
    }

    /// Drops all items; the capacity stays.
    pub fn clear(&mut self) {
        self.items.clear();
    }

    /// Drops the items from `n` on; the capacity stays.
    pub fn truncate(&mut self, n: usize) {
        self.items.truncate(n);
    }

    /// Changes the capacity to `n`, or to its length if that is more.
    ///
    /// Old and new place exist at once while the items move, and both are reserved for that moment.
    ///
    /// # Errors
    /// When the budget, or the operating system, has not got the bytes; nothing changes then.
    pub fn resize_capacity(&mut self, n: usize) -> Result<(), BudgetError> {
        let n = n.max(self.items.len());
        if n != self.capacity {
            let budget = self.reservation.budget.clone();
            let (mut items, reservation) = allocate(&budget, n, self.reservation.what)?;
            items.append(&mut self.items);
            *self = Self { items, capacity: n, reservation };
        }
        Ok(())
    }
}

impl<T> Deref for Array<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        &self.items
    }
}

impl<T> DerefMut for Array<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.items
    }
}

impl<T: fmt::Debug> fmt::Debug for Array<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.items.fmt(f)
    }
}

/// An [`Array`] has no place for what was to be appended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the array is full: it has place for {capacity} items")]
pub struct ArrayFull {
    /// Items that it has place for.
    pub capacity: usize,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MIB: u64 = 1 << 20;

    #[test]
    fn a_refusal_names_the_largest_holders() {
        let budget = MemoryBudget::new(380 * MIB);
        let _geometry = budget.reserve(200 * MIB, "geometry").unwrap();
        let _photons = budget.reserve(60 * MIB, "photons").unwrap();
        let error = budget.reserve(175 * MIB, "grid of a tile").unwrap_err();
        assert_eq!(
            error.to_string(),
            "grid of a tile needs 175 MiB, 120 MiB of 380 MiB are free \
             (largest holders: geometry 200 MiB, photons 60.0 MiB)"
        );
        assert_eq!((error.needed, error.available, error.limit), (175 * MIB, 120 * MIB, 380 * MIB));
        assert_eq!(budget.reserved(), 260 * MIB, "a refusal takes nothing");
    }

    #[test]
    fn a_refusal_by_a_single_byte_says_so() {
        let budget = MemoryBudget::new(MIB);
        let error = budget.reserve(MIB + 1, "queue").unwrap_err();
        assert_eq!(error.to_string(), "queue needs 1048577 B, 1048576 B of 1.0 MiB are free");
    }

    #[test]
    fn the_system_may_refuse_what_the_budget_grants() {
        let budget = MemoryBudget::new(u64::MAX);
        let error = Buffer::zeroed(&budget, 1 << 62, "everything").unwrap_err();
        assert!(error.to_string().contains("operating system"), "{error}");
        let error = Array::<u64>::with_capacity(&budget, usize::MAX, "more").unwrap_err();
        assert!(error.to_string().contains("operating system"), "{error}");
        assert_eq!(budget.reserved(), 0);
    }

    proptest! {
        #[test]
        fn counters_follow_every_reservation(
            steps in proptest::collection::vec((0u8..3, 0usize..8, 0u64..400), 1..80),
        ) {
            const NAMES: [&str; 3] = ["a", "b", "c"];
            let budget = MemoryBudget::new(1000);
            let mut held: Vec<(usize, Reservation)> = Vec::new();
            let mut peak = 0;
            for (action, which, bytes) in steps {
                let before: u64 = held.iter().map(|h| h.1.bytes()).sum();
                let slot = which % held.len().max(1);
                match action {
                    0 => match budget.reserve(bytes, NAMES[which % 3]) {
                        Ok(r) => held.push((which % 3, r)),
                        Err(e) => {
                            prop_assert!(before + bytes > 1000);
                            prop_assert_eq!(e.available, 1000 - before);
                        }
                    },
                    1 if !held.is_empty() => {
                        let old = held[slot].1.bytes();
                        let fits = before - old + bytes <= 1000;
                        prop_assert_eq!(held[slot].1.resize(bytes).is_ok(), fits);
                        prop_assert_eq!(held[slot].1.bytes(), if fits { bytes } else { old });
                    }
                    2 if !held.is_empty() => drop(held.swap_remove(slot)),
                    _ => {}
                }
                let now: u64 = held.iter().map(|h| h.1.bytes()).sum();
                if now > peak {
                    peak = now;
                    prop_assert_eq!(budget.peak_holders(), budget.holders());
                }
                prop_assert_eq!(budget.peak_holders().iter().map(|h| h.1).sum::<u64>(), peak);
                prop_assert_eq!(budget.reserved(), now);
                prop_assert_eq!(budget.available(), 1000 - now);
                prop_assert_eq!(budget.peak(), peak);
                prop_assert_eq!(budget.holders().iter().map(|h| h.1).sum::<u64>(), now);
                for (name, bytes) in budget.holders() {
                    let sum = held.iter().filter(|h| NAMES[h.0] == name).map(|h| h.1.bytes()).sum();
                    prop_assert_eq!(bytes, sum);
                }
            }
            held.clear();
            prop_assert_eq!(budget.reserved(), 0);
        }

        #[test]
        fn buffers_are_aligned_zeroed_and_counted(len in prop_oneof![0usize..300, 130_000usize..140_000]) {
            let budget = MemoryBudget::new(1 << 20);
            let mut buffer = Buffer::zeroed(&budget, len, "test").unwrap();
            prop_assert_eq!(buffer.as_ptr() as usize % 64, 0);
            prop_assert_eq!(buffer.len(), len);
            prop_assert!(buffer.iter().all(|&b| b == 0));
            prop_assert_eq!(budget.reserved(), len as u64);
            buffer.fill(7);
            prop_assert!(buffer.iter().all(|&b| b == 7));
            prop_assert_eq!(buffer.as_slice_of::<u64>().is_ok(), len % 8 == 0);
            prop_assert_eq!(buffer.as_mut_slice_of::<[f32; 6]>().is_ok(), len % 24 == 0);
            prop_assert_eq!(buffer.padded_mut().len(), len.max(1).next_multiple_of(64));
            drop(buffer);
            prop_assert_eq!(budget.reserved(), 0);
        }
    }

    #[test]
    fn threads_never_reserve_more_than_there_is() {
        let budget = MemoryBudget::new(1000);
        std::thread::scope(|scope| {
            for t in 0..4u64 {
                let budget = &budget;
                scope.spawn(move || {
                    for i in 0..2000 {
                        if let Ok(mut r) = budget.reserve((i * 7 + t * 13) % 600, "thread") {
                            assert!(budget.reserved() <= 1000);
                            let _ = r.resize(i % 300);
                        }
                    }
                });
            }
        });
        assert_eq!(budget.reserved(), 0);
        assert!(budget.peak() <= 1000 && budget.holders().is_empty());
    }

    #[test]
    fn an_array_never_grows_by_itself() {
        let budget = MemoryBudget::new(100);
        let mut array = Array::with_capacity(&budget, 3, "list").unwrap();
        assert_eq!(budget.reserved(), 12);
        assert_eq!(array.push(1u32), Ok(()));
        assert_eq!(array.extend_from_slice(&[2, 3, 4]), Err(ArrayFull { capacity: 3 }));
        assert_eq!(*array, [1], "all or none");
        array.extend_from_slice(&[2, 3]).unwrap();
        assert_eq!(array.push(4), Err(4));
        assert!(array.is_full() && array.resize(4, 0).is_err());
        array.resize_capacity(10).unwrap();
        assert_eq!((array.capacity(), budget.reserved(), &array[..]), (10, 40, &[1, 2, 3][..]));
        assert!(array.resize_capacity(20).is_err(), "both at once need 120 bytes");
        assert_eq!((array.capacity(), budget.reserved(), array.len()), (10, 40, 3));
        array[1] = 9;
        array.truncate(2);
        array.resize_capacity(0).unwrap();
        assert_eq!((array.capacity(), budget.reserved(), &array[..]), (2, 8, &[1, 9][..]));
        assert_eq!(array.pop(), Some(9));
        array.clear();
        assert!(array.is_empty());
        drop(array);
        assert_eq!(budget.reserved(), 0);
        let mut units = Array::with_capacity(&budget, 2, "nothing").unwrap();
        assert_eq!((units.push(()), units.push(()), units.push(())), (Ok(()), Ok(()), Err(())));
    }
}
