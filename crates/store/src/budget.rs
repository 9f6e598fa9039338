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
use memmap2::MmapMut;
use parking_lot::Mutex;
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

/// The source of all large memory of a process. Cloning gives another handle to the same budget.
#[derive(Clone)]
pub struct MemoryBudget(Arc<Inner>);

struct Inner {
    limit: u64,
    reserved: AtomicU64,
    peak: AtomicU64,
    /// Bytes per holder, in order of first appearance. A few dozen entries.
    holders: Mutex<Vec<(&'static str, u64)>>,
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
        let mut list: Vec<_> = self.0.holders.lock().iter().filter(|h| h.1 > 0).copied().collect();
        list.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(b.0)));
        list
    }

    fn take(&self, bytes: u64, what: &'static str) -> Result<(), BudgetError> {
        let limit = self.0.limit;
        let room = |now: u64| now.checked_add(bytes).filter(|&after| after <= limit);
        let order = Ordering::Relaxed;
        match self.0.reserved.fetch_update(order, order, room) {
            Ok(before) => {
                self.0.peak.fetch_max(before + bytes, order);
                let mut holders = self.0.holders.lock();
                match holders.iter_mut().find(|h| h.0 == what) {
                    Some(holder) => holder.1 += bytes,
                    None => holders.push((what, bytes)),
                }
                Ok(())
            }
            Err(now) => Err(self.refusal(bytes, what, limit.saturating_sub(now))),
        }
    }

    fn give_back(&self, bytes: u64, what: &'static str) {
        if let Some(holder) = self.0.holders.lock().iter_mut().find(|h| h.0 == what) {
            holder.1 -= bytes;
        }
        self.0.reserved.fetch_sub(bytes, Ordering::Relaxed);
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
        let reservation = budget.reserve(len as u64, what)?;
        let lines = len.div_ceil(64).max(1);
        let storage = if len >= OWN_PAGES {
            lines
                .checked_mul(64)
                .ok_or(io::ErrorKind::OutOfMemory.into())
                .and_then(MmapMut::map_anon)
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
