//! The table of incoming records, the paper's `TP` (Fradin et al. 2005, sections 4.1 and 5.1).
//!
//! Photons that cross a portal wait here for their tile to be loaded. One row per tile that has
//! something waiting; a fixed number of rows, each of a fixed length. When a row fills up it is
//! written in one go; when a tile needs a row and none is free, the row that was used longest ago
//! is written and given away. So memory is `rows x block`, whatever the number of tiles, and the
//! disk sees long writes.
//!
//! The table has one owner, the recorder thread, and no locks: tracers send it what a job has produced through
//! a channel. It knows nothing of disks; where a row goes is the caller's `spill`.

use std::collections::HashMap;
use std::vec::Drain;

/// No row: the end of the list of used rows.
const NO_ROW: usize = usize::MAX;

/// Takes records that leave the table for the disk: the id, and its records from the oldest on.
pub type Spill<'a, T, E> = dyn FnMut(u32, &[T]) -> Result<(), E> + 'a;

/// A bounded table of rows of records, one row per id, replaced in least-recently-used order.
///
/// Within an id, records leave in the order in which they came: first to `spill`, then to
/// [`Self::take`].
pub struct RowTable<T> {
    rows: Vec<Row<T>>,
    /// Row of each id that has records in memory. Looked up only, never iterated.
    row_of: HashMap<u32, usize>,
    /// Empty rows. Last in, first out, so that memory that was touched is touched again.
    free: Vec<usize>,
    /// Rows that were ever used; those behind have no memory yet.
    opened: usize,
    limit: usize,
    block: usize,
    newest: usize,
    oldest: usize,
    nothing: Vec<T>,
    evictions: u64,
    spilled_blocks: u64,
    spilled_records: u64,
}

struct Row<T> {
    id: u32,
    records: Vec<T>,
    newer: usize,
    older: usize,
}

impl<T: Copy> RowTable<T> {
    /// A table of at most `rows` rows of `block` records (at least one of each). A row's memory is
    /// allocated when it is first used, kept and reused; reserve [`Self::memory_bytes`] before.
    pub fn new(rows: usize, block: usize) -> Self {
        Self {
            rows: Vec::new(),
            row_of: HashMap::new(),
            free: Vec::new(),
            opened: 0,
            limit: rows.max(1),
            block: block.max(1),
            newest: NO_ROW,
            oldest: NO_ROW,
            nothing: Vec::new(),
            evictions: 0,
            spilled_blocks: 0,
            spilled_records: 0,
        }
    }

    /// The bytes that a table of these dimensions can come to hold.
    pub fn memory_bytes(rows: usize, block: usize) -> u64 {
        // A row's own fields, its place in the map (at most 8/7 of a power of two) and in `free`.
        const PER_ROW: u64 = 128;
        let row = (block.max(1) as u64).saturating_mul(size_of::<T>() as u64);
        (rows.max(1) as u64).saturating_mul(row.saturating_add(PER_ROW))
    }

    /// Appends records to the row of `id`.
    ///
    /// A row that is full is handed to `spill` at once; a block that comes whole to an empty row
    /// is handed on without being copied. If `id` has no row and none is free, the row used
    /// longest ago is handed to `spill` first.
    ///
    /// # Errors
    /// What `spill` says. The row that it refused is kept and handed to it again when next its
    /// turn comes; of `records` a part may have been taken, so a run does not go on from here.
    pub fn push<E>(
        &mut self,
        id: u32,
        mut records: &[T],
        spill: &mut Spill<'_, T, E>,
    ) -> Result<(), E> {
        while !records.is_empty() {
            let Some(row) = self.row_of.get(&id).copied() else {
                if records.len() >= self.block {
                    let (whole, rest) = records.split_at(self.block);
                    spill(id, whole)?;
                    self.count_spill(whole.len());
                    records = rest;
                } else {
                    self.open(id, spill)?;
                }
                continue;
            };
            self.touch(row);
            let free = self.block.saturating_sub(self.rows[row].records.len());
            let (now, later) = records.split_at(free.min(records.len()));
            self.rows[row].records.extend_from_slice(now);
            records = later;
            if self.rows[row].records.len() >= self.block {
                self.spill_row(row, spill)?;
            }
        }
        Ok(())
    }

    /// Takes what is in memory for `id`, oldest first; its row is free afterwards.
    pub fn take(&mut self, id: u32) -> Drain<'_, T> {
        match self.row_of.remove(&id) {
            Some(row) => {
                self.release(row);
                self.rows[row].records.drain(..)
            }
            None => self.nothing.drain(..),
        }
    }

    /// Hands every row that is not empty to `spill`, in order of ids. What an epoch begins with.
    ///
    /// # Errors
    /// What `spill` says; rows that it has not accepted are kept.
    pub fn flush_all<E>(&mut self, spill: &mut Spill<'_, T, E>) -> Result<(), E> {
        let mut used = Vec::new();
        let mut row = self.oldest;
        while row != NO_ROW {
            used.push((self.rows[row].id, row));
            row = self.rows[row].newer;
        }
        used.sort_unstable();
        used.into_iter().try_for_each(|(_, row)| self.spill_row(row, spill))
    }

    /// Records in memory for `id`.
    pub fn pending(&self, id: u32) -> usize {
        self.row_of.get(&id).map_or(0, |&row| self.rows[row].records.len())
    }

    /// Rows that hold something.
    pub fn used_rows(&self) -> usize {
        self.row_of.len()
    }

    /// Records that fit in a row.
    pub fn block_len(&self) -> usize {
        self.block
    }

    /// Rows that were written because another id needed the place (`table.evictions`).
    pub fn evictions(&self) -> u64 {
        self.evictions
    }

    /// Rows and whole blocks that `spill` accepted (`table.spilled_blocks`).
    pub fn spilled_blocks(&self) -> u64 {
        self.spilled_blocks
    }

    /// Records that `spill` accepted (`io.spilled_records`).
    pub fn spilled_records(&self) -> u64 {
        self.spilled_records
    }

    /// Gives `id` an empty row, as the newest.
    fn open<E>(&mut self, id: u32, spill: &mut Spill<'_, T, E>) -> Result<(), E> {
        if self.free.is_empty() && self.opened == self.limit {
            self.spill_row(self.oldest, spill)?;
            self.evictions += 1;
        }
        let row = self.free.pop().unwrap_or_else(|| {
            let records = Vec::with_capacity(self.block);
            self.rows.push(Row { id, records, newer: NO_ROW, older: NO_ROW });
            self.opened += 1;
            self.opened - 1
        });
        self.rows[row].id = id;
        self.link_newest(row);
        self.row_of.insert(id, row);
        Ok(())
    }

    /// Hands a row to `spill` and frees it.
    fn spill_row<E>(&mut self, row: usize, spill: &mut Spill<'_, T, E>) -> Result<(), E> {
        let Row { id, records, .. } = &self.rows[row];
        spill(*id, records)?;
        let (id, n) = (*id, records.len());
        self.count_spill(n);
        self.rows[row].records.clear();
        self.row_of.remove(&id);
        self.release(row);
        Ok(())
    }

    fn count_spill(&mut self, records: usize) {
        self.spilled_blocks += 1;
        self.spilled_records += records as u64;
    }

    fn release(&mut self, row: usize) {
        self.unlink(row);
        self.free.push(row);
    }

    fn touch(&mut self, row: usize) {
        if self.newest != row {
            self.unlink(row);
            self.link_newest(row);
        }
    }

    fn unlink(&mut self, row: usize) {
        let (newer, older) = (self.rows[row].newer, self.rows[row].older);
        match newer {
            NO_ROW => self.newest = older,
            _ => self.rows[newer].older = older,
        }
        match older {
            NO_ROW => self.oldest = newer,
            _ => self.rows[older].newer = newer,
        }
    }

    fn link_newest(&mut self, row: usize) {
        self.rows[row].newer = NO_ROW;
        self.rows[row].older = self.newest;
        match self.newest {
            NO_ROW => self.oldest = row,
            newest => self.rows[newest].newer = row,
        }
        self.newest = row;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;
    use std::convert::Infallible;

    type Disk = BTreeMap<u32, Vec<u32>>;

    fn push(table: &mut RowTable<u32>, id: u32, records: &[u32], log: &mut Vec<(u32, Vec<u32>)>) {
        table
            .push::<Infallible>(id, records, &mut |id, records| {
                log.push((id, records.to_vec()));
                Ok(())
            })
            .unwrap();
    }

    #[test]
    fn full_rows_go_out_whole() {
        let (mut table, mut log) = (RowTable::new(2, 3), vec![]);
        push(&mut table, 5, &[1, 2], &mut log);
        assert_eq!((table.pending(5), log.len()), (2, 0));
        push(&mut table, 5, &[3, 4, 5, 6, 7], &mut log);
        assert_eq!(log, [(5, vec![1, 2, 3]), (5, vec![4, 5, 6])]);
        assert_eq!(table.take(5).collect::<Vec<_>>(), [7]);
        assert_eq!((table.pending(5), table.used_rows()), (0, 0));
        assert_eq!((table.evictions(), table.spilled_blocks(), table.spilled_records()), (0, 2, 6));
    }

    #[test]
    fn the_row_used_longest_ago_gives_way() {
        let (mut table, mut log) = (RowTable::new(2, 10), vec![]);
        push(&mut table, 1, &[10], &mut log);
        push(&mut table, 2, &[20], &mut log);
        push(&mut table, 1, &[11], &mut log);
        push(&mut table, 3, &[30], &mut log);
        assert_eq!(log, [(2, vec![20])]);
        push(&mut table, 2, &[21], &mut log);
        assert_eq!(log[1], (1, vec![10, 11]));
        assert_eq!(table.evictions(), 2);
        assert_eq!(table.take(1).len(), 0);
        assert_eq!(table.take(3).len(), 1);
        push(&mut table, 4, &[40], &mut log);
        assert_eq!((log.len(), table.evictions()), (2, 2));
    }

    #[test]
    fn a_flush_is_in_order_of_ids() {
        let (mut table, mut log) = (RowTable::new(8, 10), vec![]);
        for id in [7, 1, 4, 1, 0] {
            push(&mut table, id, &[id, id + 100], &mut log);
        }
        table
            .flush_all::<Infallible>(&mut |id, records| {
                log.push((id, records.to_vec()));
                Ok(())
            })
            .unwrap();
        assert_eq!(
            log,
            [(0, vec![0, 100]), (1, vec![1, 101, 1, 101]), (4, vec![4, 104]), (7, vec![7, 107])]
        );
        assert_eq!((table.used_rows(), table.evictions(), table.spilled_records()), (0, 0, 10));
    }

    #[test]
    fn memory_is_what_was_said() {
        let (mut table, mut log) = (RowTable::<u32>::new(3, 100), vec![]);
        assert_eq!(table.rows.capacity(), 0);
        for i in 0..1000 {
            push(&mut table, i % 50, &[i; 70], &mut log);
        }
        let held: usize = table.rows.iter().map(|r| r.records.capacity() * 4).sum();
        assert_eq!((table.rows.len(), held), (3, 3 * 100 * 4));
        assert!(RowTable::<u32>::memory_bytes(3, 100) >= held as u64);
        assert_eq!(RowTable::<u64>::memory_bytes(usize::MAX, usize::MAX), u64::MAX);
        assert_eq!(RowTable::<u32>::new(0, 0).block_len(), 1);
    }

    #[test]
    fn a_refused_row_is_kept() {
        let mut table = RowTable::new(1, 4);
        let mut log = vec![];
        push(&mut table, 1, &[1, 2], &mut log);
        let mut refuse = |_: u32, _: &[u32]| Err("disk full");
        assert_eq!(table.push(2, &[9], &mut refuse), Err("disk full"));
        assert_eq!(table.flush_all(&mut refuse), Err("disk full"));
        assert_eq!((table.pending(1), table.pending(2), table.evictions()), (2, 0, 0));
        assert_eq!(table.push(1, &[3, 4, 5], &mut refuse), Err("disk full"));
        assert_eq!(table.pending(1), 4);
        push(&mut table, 1, &[6], &mut log);
        assert_eq!(log, [(1, vec![1, 2, 3, 4])]);
        assert_eq!(table.take(1).as_slice(), [6]);
    }

    #[derive(Clone, Debug)]
    enum Step {
        Push(u32, usize),
        Take(u32),
        Flush,
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            12 => (0u32..9, 0usize..14).prop_map(|(id, n)| Step::Push(id, n)),
            3 => (0u32..9).prop_map(Step::Take),
            1 => Just(Step::Flush),
        ]
    }

    /// What a table should do, with no cleverness: rows from the least to the most recently used.
    struct Model {
        rows: Vec<(u32, Vec<u32>)>,
        limit: usize,
        block: usize,
        log: Vec<(u32, Vec<u32>)>,
        evictions: u64,
    }

    impl Model {
        fn push(&mut self, id: u32, records: &[u32]) {
            for &record in records {
                let row = match self.rows.iter().position(|r| r.0 == id) {
                    Some(at) => self.rows.remove(at),
                    None => (id, vec![]),
                };
                self.rows.push(row);
                self.rows.last_mut().unwrap().1.push(record);
                if self.rows.last().unwrap().1.len() == self.block {
                    self.log.push(self.rows.pop().unwrap());
                }
            }
        }

        /// Evicts as late as the table does: when the rest of a push needs a row of its own.
        fn push_evicting(&mut self, id: u32, records: &[u32]) {
            let held = self.rows.iter().find(|r| r.0 == id).map_or(0, |r| r.1.len());
            let rest = (held + records.len()) % self.block;
            let filled = held + records.len() - rest;
            let whole = filled.saturating_sub(held).min(records.len());
            self.push(id, &records[..whole]);
            let has_row = self.rows.iter().any(|r| r.0 == id);
            if whole < records.len() && !has_row && self.rows.len() == self.limit {
                self.log.push(self.rows.remove(0));
                self.evictions += 1;
            }
            self.push(id, &records[whole..]);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        #[test]
        fn it_is_the_model(
            rows in 1usize..5,
            block in 1usize..7,
            steps in prop::collection::vec(step(), 1..120),
        ) {
            let mut table = RowTable::new(rows, block);
            let mut model =
                Model { rows: vec![], limit: rows, block, log: vec![], evictions: 0 };
            let (mut log, mut serial) = (vec![], 0u32);
            let (mut sent, mut got) = (Disk::new(), Disk::new());
            for step in steps {
                match step {
                    Step::Push(id, n) => {
                        let records: Vec<u32> = (serial..).take(n).collect();
                        serial += n as u32;
                        sent.entry(id).or_default().extend(&records);
                        push(&mut table, id, &records, &mut log);
                        model.push_evicting(id, &records);
                    }
                    Step::Take(id) => {
                        let taken: Vec<u32> = table.take(id).collect();
                        let at = model.rows.iter().position(|r| r.0 == id);
                        let expected = at.map_or(vec![], |at| model.rows.remove(at).1);
                        prop_assert_eq!(&taken, &expected);
                        // What was spilled before is read before.
                        for (_, spilled) in log.iter().filter(|(of, _)| *of == id) {
                            got.entry(id).or_default().extend(spilled);
                        }
                        log.retain(|(of, _)| *of != id);
                        model.log.retain(|(of, _)| *of != id);
                        got.entry(id).or_default().extend(taken);
                    }
                    Step::Flush => {
                        table.flush_all::<Infallible>(&mut |id, records| {
                            log.push((id, records.to_vec()));
                            Ok(())
                        }).unwrap();
                        model.rows.sort_by_key(|r| r.0);
                        model.log.append(&mut model.rows);
                    }
                }
                prop_assert_eq!(&log, &model.log);
                prop_assert_eq!(table.evictions(), model.evictions);
                prop_assert_eq!(table.used_rows(), model.rows.len());
                for (id, records) in &model.rows {
                    prop_assert_eq!(table.pending(*id), records.len());
                }
                prop_assert!(table.rows.len() <= rows);
                prop_assert!(table.rows.iter().all(|r| r.records.capacity() <= block.max(4)));
            }
            for (id, records) in log {
                got.entry(id).or_default().extend(records);
            }
            for id in 0..9 {
                got.entry(id).or_default().extend(table.take(id));
                sent.entry(id).or_default();
            }
            prop_assert_eq!(got, sent, "nothing is lost, doubled or out of order");
        }
    }
}
