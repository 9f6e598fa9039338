//! Triangles sorted to pieces of rooms, on disk.
//!
//! A bounded table of rows gathers what each piece gets (as photons at portals are gathered); full rows
//! go to a scratch file, each with the place of the piece's row before it. So a piece is a chain of blocks
//! that is read backwards, and what stays in memory per piece is 24 bytes, however many triangles it has.

use enf_stage::{Result, RowTable};
use enf_store::{Array, MemoryBudget, Reservation, ScratchFile, StoreDir, StoreError};
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

/// Rows are at most so long, records.
const LONGEST_ROW: u64 = 8192;
/// Shorter ones would make the disk hop.
const SHORTEST_ROW: u64 = 64;
/// More memory than this speeds nothing up.
const MOST_MEMORY: u64 = 96 << 20;
const LEAST_MEMORY: u64 = 512 << 10;

/// A triangle on its way to its tiles. In this process only: a scratch file is never read by another.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct Record {
    /// Corners in store coordinates, m.
    pub(crate) corners: [[f32; 3]; 3],
    /// Index in the scene.
    pub(crate) index: u32,
    /// Material.
    pub(crate) material: u32,
}

/// Where a piece's last block lies, and how many records there are.
#[derive(Clone, Copy, Debug, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Chain {
    at: u64,
    records: u64,
    all: u64,
}

/// What stands before a block: the block before it.
#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Before {
    at: u64,
    records: u64,
}

/// Bins that are being filled, by one thread.
pub(crate) struct Filling {
    table: RowTable<Record>,
    file: ScratchFile,
    chains: Array<Chain>,
    longest: usize,
    _reserved: Reservation,
}

/// Bins that are full. Threads may read them at once.
pub(crate) struct Bins {
    file: ScratchFile,
    chains: Array<Chain>,
    /// Records of the longest block.
    longest: usize,
}

impl Filling {
    /// What it takes at least, with few bins.
    pub(crate) const LEAST_BYTES: u64 = LEAST_MEMORY + ScratchFile::MEMORY_BYTES;

    /// Bins `0..count`; they take a third of what is free, within reason.
    ///
    /// # Errors
    /// Exit 3 without memory, exit 5 without a place for the scratch file.
    pub(crate) fn new(store: &StoreDir, budget: &MemoryBudget, count: usize) -> Result<Self> {
        let memory = (budget.available() / 3).clamp(LEAST_MEMORY, MOST_MEMORY);
        let one = RowTable::<Record>::memory_bytes(1, 1) - size_of::<Record>() as u64;
        let record = size_of::<Record>() as u64;
        let block = (memory / count.max(1) as u64).saturating_sub(one) / record;
        let block = block.clamp(SHORTEST_ROW, LONGEST_ROW);
        let rows = (memory / (block * record + one)).clamp(1, count.max(1) as u64);
        let needs = RowTable::<Record>::memory_bytes(rows as usize, block as usize);
        let reserved =
            budget.reserve(needs + ScratchFile::MEMORY_BYTES, "triangles on their way to rooms")?;
        let mut chains = Array::with_capacity(budget, count, "triangles on their way to rooms")?;
        // Just made with place for them.
        let _ = chains.resize(count, Chain::default());
        Ok(Self {
            table: RowTable::new(rows as usize, block as usize),
            file: ScratchFile::new(store)?,
            chains,
            longest: 0,
            _reserved: reserved,
        })
    }

    /// Appends records to a bin.
    ///
    /// # Errors
    /// Exit 5 when the scratch file takes no more.
    pub(crate) fn push(&mut self, bin: u32, records: &[Record]) -> Result<()> {
        let Self { table, file, chains, longest, .. } = self;
        Ok(table
            .push(bin, records, &mut |bin, records| spill(file, chains, longest, bin, records))?)
    }

    /// Puts everything on disk, ready to be read.
    ///
    /// # Errors
    /// Exit 5 when the scratch file takes no more.
    pub(crate) fn full(mut self) -> Result<Bins> {
        let Self { table, file, chains, longest, .. } = &mut self;
        table.flush_all(&mut |bin, records| spill(file, chains, longest, bin, records))?;
        self.file.flush()?;
        Ok(Bins { file: self.file, chains: self.chains, longest: self.longest })
    }
}

fn spill(
    file: &mut ScratchFile,
    chains: &mut Array<Chain>,
    longest: &mut usize,
    bin: u32,
    records: &[Record],
) -> std::result::Result<(), StoreError> {
    let chain = &mut chains[bin as usize];
    let before = Before { at: chain.at, records: chain.records };
    chain.at = file.append(&[before.as_bytes(), records.as_bytes()])?;
    chain.records = records.len() as u64;
    chain.all += records.len() as u64;
    *longest = records.len().max(*longest);
    Ok(())
}

impl Bins {
    /// Records in a bin.
    pub(crate) fn count(&self, bin: u32) -> u64 {
        self.chains.get(bin as usize).map_or(0, |c| c.all)
    }

    /// Bytes that a reader holds.
    pub(crate) fn read_bytes(&self) -> u64 {
        (size_of::<Before>() + self.longest * size_of::<Record>()) as u64
    }

    /// Calls `found` with all records of a bin, block by block, in no particular order.
    ///
    /// # Errors
    /// Exit 5 when the scratch file cannot be read, and what `found` says.
    pub(crate) fn read(
        &self,
        bin: u32,
        mut found: impl FnMut(&[Record]) -> Result<()>,
    ) -> Result<()> {
        let Some(&chain) = self.chains.get(bin as usize) else { return Ok(()) };
        let mut block = <[Record]>::new_box_zeroed_with_elems(self.longest)
            .map_err(|_| enf_stage::Failure::internal("no memory for a block of triangles"))?;
        let mut next = Before { at: chain.at, records: chain.records };
        while next.records > 0 {
            let here = next;
            let records = &mut block[..here.records as usize];
            self.file.read(here.at, next.as_mut_bytes())?;
            self.file.read(here.at + size_of::<Before>() as u64, records.as_mut_bytes())?;
            found(records)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_give_back_what_was_put_in() {
        let dir = tempfile::tempdir().unwrap();
        let store = StoreDir::create(dir.path().join("a.enf")).unwrap();
        // Little memory, many bins: rows are evicted and chains get long.
        let budget = MemoryBudget::new(6 << 20);
        let bins = 1000u32;
        let mut filling = Filling::new(&store, &budget, bins as usize).unwrap();
        let mut state = 1u64;
        let mut put = vec![Vec::new(); bins as usize];
        for index in 0..200_000u32 {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let bin = ((state >> 33) % u64::from(bins - 1)) as u32;
            let record = Record { corners: [[index as f32; 3]; 3], index, material: bin };
            filling.push(bin, &[record]).unwrap();
            put[bin as usize].push(record);
        }
        let full = filling.full().unwrap();
        for (bin, want) in put.iter().enumerate() {
            let mut got = Vec::new();
            full.read(bin as u32, |records| {
                got.extend_from_slice(records);
                Ok(())
            })
            .unwrap();
            got.sort_by_key(|r| r.index);
            assert_eq!(&got, want);
            assert_eq!(full.count(bin as u32), want.len() as u64);
        }
        assert!(budget.peak() <= budget.limit());
    }
}
