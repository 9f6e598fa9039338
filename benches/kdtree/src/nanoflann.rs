//! nanoflann, behind a few lines of C++.
#![allow(unsafe_code)]

use std::ffi::c_void;
use std::marker::PhantomData;

unsafe extern "C" {
    fn bench_nanoflann_build(points: *const f32, count: usize) -> *mut c_void;
    fn bench_nanoflann_drop(index: *mut c_void);
    fn bench_nanoflann_ask(
        index: *const c_void,
        queries: *const f32,
        count: usize,
        k: usize,
        radius: f32,
        sum: *mut f64,
    ) -> usize;
}

/// A tree over points that somebody else keeps.
pub struct Nanoflann<'a> {
    index: *mut c_void,
    points: PhantomData<&'a [[f32; 3]]>,
}

impl<'a> Nanoflann<'a> {
    /// Builds; `None` where there is no memory.
    pub fn new(points: &'a [[f32; 3]]) -> Option<Self> {
        // SAFETY: the points are `3 * len` floats in a row, which outlive the index by its lifetime.
        let index = unsafe { bench_nanoflann_build(points.as_ptr().cast(), points.len()) };
        (!index.is_null()).then_some(Self { index, points: PhantomData })
    }

    /// Photons found for all queries together, and the sum of the squared distances of the farthest ones.
    pub fn ask(&self, queries: &[[f32; 3]], k: usize, radius: f32) -> (usize, f64) {
        let mut sum = 0.0;
        let (at, count) = (queries.as_ptr().cast(), queries.len());
        // SAFETY: the index is alive, the queries are `3 * count` floats, and the sum is written to before this returns.
        let found = unsafe { bench_nanoflann_ask(self.index, at, count, k, radius, &raw mut sum) };
        (found, sum)
    }
}

impl Drop for Nanoflann<'_> {
    fn drop(&mut self) {
        // SAFETY: made by `bench_nanoflann_build`, dropped once.
        unsafe { bench_nanoflann_drop(self.index) }
    }
}
