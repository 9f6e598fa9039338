//! Blocks of records on their way from many tracers to one writer.
//!
//! One photon per queue operation would cost more than the photon. So a tracer fills a [`Block`]
//! and sends the block; when the writer drops it, it is back in the pool. The number of blocks is
//! fixed: a tracer that outruns the writer waits here, and memory stays where the budget put it.

use std::ops::{Deref, DerefMut};

use crossbeam::channel::{Receiver, Sender, bounded};

/// A fixed number of reusable blocks, each with room for the same number of records. Clones share
/// the blocks.
///
/// Underneath is a bounded array queue: taking and returning is lock-free as long as there is a
/// block to take, and parks the thread when there is none.
pub struct BlockPool<T> {
    free: Receiver<Vec<T>>,
    back: Sender<Vec<T>>,
    block: usize,
}

impl<T> Clone for BlockPool<T> {
    fn clone(&self) -> Self {
        Self { free: self.free.clone(), back: self.back.clone(), block: self.block }
    }
}

impl<T> BlockPool<T> {
    /// A pool of `blocks` blocks of `block` records each (at least one of each). A block's memory
    /// is allocated when it is first taken; reserve [`Self::memory_bytes`] in the budget before.
    pub fn new(blocks: usize, block: usize) -> Self {
        let blocks = blocks.max(1);
        let (back, free) = bounded(blocks);
        for _ in 0..blocks {
            // The queue has exactly this many places.
            let _ = back.try_send(Vec::new());
        }
        Self { free, back, block: block.max(1) }
    }

    /// The bytes that a pool of these dimensions can come to hold.
    pub fn memory_bytes(blocks: usize, block: usize) -> u64 {
        (blocks.max(1) as u64)
            .saturating_mul(block.max(1) as u64)
            .saturating_mul(size_of::<T>() as u64)
    }

    /// Records that fit in one block.
    pub fn block_len(&self) -> usize {
        self.block
    }

    /// Blocks that could be taken now without waiting.
    pub fn free(&self) -> usize {
        self.free.len()
    }

    /// An empty block; waits for one to be dropped if all are out.
    pub fn get(&self) -> Block<T> {
        // Cannot fail: this pool itself holds the other end.
        let records = self.free.recv().unwrap_or_default();
        self.dress(records)
    }

    /// An empty block, if one is free now.
    pub fn try_get(&self) -> Option<Block<T>> {
        self.free.try_recv().ok().map(|records| self.dress(records))
    }

    fn dress(&self, mut records: Vec<T>) -> Block<T> {
        records.reserve_exact(self.block);
        Block { records, block: self.block, home: self.back.clone() }
    }
}

/// A block of at most [`BlockPool::block_len`] records; dropping it gives it back, emptied.
pub struct Block<T> {
    records: Vec<T>,
    block: usize,
    home: Sender<Vec<T>>,
}

impl<T> Block<T> {
    /// Appends a record.
    ///
    /// # Errors
    /// The record itself, if the block is full.
    pub fn push(&mut self, record: T) -> Result<(), T> {
        if self.is_full() {
            return Err(record);
        }
        self.records.push(record);
        Ok(())
    }

    /// Whether no further record fits.
    pub fn is_full(&self) -> bool {
        self.records.len() >= self.block
    }

    /// Records that still fit.
    pub fn remaining(&self) -> usize {
        self.block.saturating_sub(self.records.len())
    }

    /// Empties the block, keeping its memory.
    pub fn clear(&mut self) {
        self.records.clear();
    }
}

impl<T: Copy> Block<T> {
    /// Appends as many of `records` as fit and says how many those were.
    pub fn extend_from_slice(&mut self, records: &[T]) -> usize {
        let n = self.remaining().min(records.len());
        self.records.extend_from_slice(&records[..n]);
        n
    }
}

impl<T> Deref for Block<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.records
    }
}

impl<T> DerefMut for Block<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.records
    }
}

impl<T> Drop for Block<T> {
    fn drop(&mut self) {
        let mut records = std::mem::take(&mut self.records);
        records.clear();
        // The pool may be gone already; then the memory simply is released.
        let _ = self.home.try_send(records);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_block_comes_back_empty_with_its_memory() {
        let pool = BlockPool::<u64>::new(1, 4);
        let mut block = pool.get();
        let memory = block.as_ptr();
        assert_eq!(block.extend_from_slice(&[1, 2, 3]), 3);
        assert_eq!(block.push(4), Ok(()));
        assert!(block.is_full());
        assert_eq!(
            (block.push(5), block.extend_from_slice(&[6]), &block[..]),
            (Err(5), 0, &[1, 2, 3, 4][..])
        );
        assert!(pool.try_get().is_none());
        drop(block);
        let block = pool.get();
        assert_eq!((block.len(), block.as_ptr(), block.remaining()), (0, memory, 4));
        assert_eq!(BlockPool::<u64>::memory_bytes(3, 4), 96);
    }

    #[test]
    fn a_block_outlives_its_pool() {
        let pool = BlockPool::<u8>::new(2, 1);
        let mut block = pool.get();
        drop(pool);
        assert_eq!(block.push(7), Ok(()));
    }

    #[test]
    fn tracers_wait_for_the_writer_and_nothing_is_lost() {
        let pool = BlockPool::<u32>::new(3, 16);
        let (sender, receiver) = crossbeam::channel::unbounded::<Block<u32>>();
        let mut seen = vec![0u32; 4 * 5000];
        std::thread::scope(|scope| {
            for tracer in 0..4u32 {
                let (pool, sender) = (pool.clone(), sender.clone());
                scope.spawn(move || {
                    let mut block = pool.get();
                    for i in 0..5000 {
                        if block.push(tracer * 5000 + i).is_err() {
                            // Send first: to hold a block while waiting for another is how four
                            // tracers and three blocks would wait forever.
                            sender.send(block).unwrap();
                            block = pool.get();
                            block.push(tracer * 5000 + i).unwrap();
                        }
                    }
                    sender.send(block).unwrap();
                });
            }
            drop(sender);
            for (n, block) in receiver.iter().enumerate() {
                if n % 100 == 0 {
                    std::thread::sleep(Duration::from_millis(1));
                }
                block.iter().for_each(|&i| seen[i as usize] += 1);
            }
        });
        assert!(seen.iter().all(|&n| n == 1));
        assert_eq!(pool.free(), 3);
    }
}
