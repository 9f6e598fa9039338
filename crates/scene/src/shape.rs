//! The triangles of one mesh: in memory, or, where they would take more than the caller allows, in
//! temporary files that have no name and vanish with the process.
//!
//! A spooled mesh is three files: vertices (24 bytes each), triangles (12) and parts (16), written and read
//! in sequence. Triangles look their vertices up through a cache of pages, which is nearly always hit,
//! because exporters write the vertices of a face shortly before it. The numbers are the same `f64` in
//! both forms, so nothing downstream can tell them apart.

use crate::{SceneError, Spool};
use std::{
    fs::File,
    io,
    ops::Range,
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
};
use zerocopy::{FromBytes, Immutable, IntoBytes};

/// A place in the mesh's own coordinates.
pub(crate) type Position = [f64; 3];

/// Items of a tail that are written in one go.
const TAIL: usize = 8192;
/// Triangles or parts that are read in one go.
const WINDOW: usize = 8192;
/// Vertices of a page.
const PAGE: usize = 1024;
/// Pages that a cache holds.
const PAGES: usize = 256;
/// A page that is not in the cache.
const ABSENT: u16 = u16::MAX;

/// A run of triangles of one object and one material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Part {
    /// One past its last triangle.
    pub(crate) end: u32,
    /// Object, an index into the mesh's objects.
    pub(crate) object: u32,
    /// Material, an index into the mesh's materials.
    pub(crate) material: u32,
    /// Named like a door.
    pub(crate) door: bool,
}

impl Part {
    fn pack(self) -> [u32; 4] {
        [self.end, self.object, self.material, u32::from(self.door)]
    }

    fn unpack([end, object, material, door]: [u32; 4]) -> Self {
        Self { end, object, material, door: door != 0 }
    }
}

/// Texture coordinates of a triangle's corners.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable)]
#[repr(C)]
pub(crate) struct Textured {
    /// Triangle of the mesh.
    pub(crate) triangle: u32,
    pub(crate) corners: [[f32; 2]; 3],
}

/// The triangles of a mesh.
#[derive(Debug)]
pub(crate) enum Shape {
    Resident(Resident),
    Spooled(Spooled),
}

/// In memory: 24 bytes a vertex, 12 a triangle (28 more with texture coordinates), 16 a part.
#[derive(Debug, Default)]
pub(crate) struct Resident {
    pub(crate) positions: Vec<Position>,
    pub(crate) triangles: Vec<[u32; 3]>,
    pub(crate) parts: Vec<Part>,
    /// Of the triangles that have some, ascending.
    pub(crate) textured: Vec<Textured>,
}

/// In files.
#[derive(Debug)]
pub(crate) struct Spooled {
    folder: PathBuf,
    positions: Column,
    triangles: Column,
    parts: Column,
    textured: Column,
}

/// A file of equal items.
#[derive(Debug)]
struct Column {
    file: File,
    len: u64,
}

/// An error of the spool: `folder` is where its files are.
fn spool_error(folder: &Path, source: io::Error) -> SceneError {
    let remedy = match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "make room there: 24 bytes a vertex and 12 a triangle"
        }
        io::ErrorKind::NotFound | io::ErrorKind::PermissionDenied => {
            "it must be a folder that can be written to"
        }
        _ => "check the disk, and that the folder can be written to",
    };
    SceneError::Spool { folder: folder.into(), source, remedy: remedy.into() }
}

impl Column {
    fn create(folder: &Path) -> Result<Self, SceneError> {
        let file = tempfile::tempfile_in(folder).map_err(|e| spool_error(folder, e))?;
        Ok(Self { file, len: 0 })
    }

    fn append<T: IntoBytes + Immutable>(
        &mut self,
        items: &[T],
        folder: &Path,
    ) -> Result<(), SceneError> {
        let at = self.len * size_of::<T>() as u64;
        self.file.write_all_at(items.as_bytes(), at).map_err(|e| spool_error(folder, e))?;
        self.len += items.len() as u64;
        Ok(())
    }

    /// Reads up to `most` items from `first` on.
    fn read<T: FromBytes + IntoBytes + Immutable + Clone>(
        &self,
        first: u64,
        most: usize,
        out: &mut Vec<T>,
        folder: &Path,
    ) -> Result<(), SceneError> {
        let n = (self.len.saturating_sub(first)).min(most as u64) as usize;
        out.resize(n, T::new_zeroed());
        let at = first * size_of::<T>() as u64;
        self.file
            .read_exact_at(out.as_mut_slice().as_mut_bytes(), at)
            .map_err(|e| spool_error(folder, e))
    }
}

/// Collects a mesh while its file is read.
pub(crate) struct Builder {
    spool: Option<Spool>,
    /// What is not in the files, if there are files.
    tail: Resident,
    files: Option<Spooled>,
    pages: Pages<Position>,
}

impl Builder {
    pub(crate) fn new(spool: Option<&Spool>) -> Self {
        Self {
            spool: spool.cloned(),
            tail: Resident::default(),
            files: None,
            pages: Pages::default(),
        }
    }

    /// Triangles so far.
    pub(crate) fn triangles(&self) -> u64 {
        self.files.as_ref().map_or(0, |f| f.triangles.len) + self.tail.triangles.len() as u64
    }

    pub(crate) fn push_vertex(&mut self, p: Position) -> Result<(), SceneError> {
        self.tail.positions.push(p);
        if self.tail.positions.len().is_multiple_of(TAIL) { self.check() } else { Ok(()) }
    }

    /// Adds a triangle of a part (whose `end` is put right here).
    pub(crate) fn push_triangle(
        &mut self,
        corners: [u32; 3],
        part: Part,
    ) -> Result<(), SceneError> {
        self.tail.triangles.push(corners);
        let end = self.triangles() as u32;
        match self.tail.parts.last_mut() {
            Some(last) if Part { end: part.end, ..*last } == part => last.end = end,
            _ => self.tail.parts.push(Part { end, ..part }),
        }
        if self.tail.triangles.len().is_multiple_of(TAIL) { self.check() } else { Ok(()) }
    }

    /// Gives the triangle that was pushed last its texture coordinates.
    pub(crate) fn push_coordinates(&mut self, corners: [[f32; 2]; 3]) -> Result<(), SceneError> {
        let triangle = (self.triangles() as u32).wrapping_sub(1);
        self.tail.textured.push(Textured { triangle, corners });
        if self.tail.textured.len().is_multiple_of(TAIL) { self.check() } else { Ok(()) }
    }

    /// A vertex that was pushed before; `None` for one that was not.
    pub(crate) fn position(&mut self, vertex: u32) -> Result<Option<Position>, SceneError> {
        let first = self.files.as_ref().map_or(0, |f| f.positions.len);
        match (&self.files, u64::from(vertex).checked_sub(first)) {
            (Some(files), None) => self.pages.get(files, vertex, |p| p).map(Some),
            (_, Some(i)) => Ok(self.tail.positions.get(i as usize).copied()),
            (None, None) => Ok(None),
        }
    }

    fn check(&mut self) -> Result<(), SceneError> {
        let Some(spool) = &self.spool else { return Ok(()) };
        if self.files.is_none() {
            if self.tail.used_bytes() <= spool.above {
                return Ok(());
            }
            self.files = Some(Spooled {
                folder: spool.folder.clone(),
                positions: Column::create(&spool.folder)?,
                triangles: Column::create(&spool.folder)?,
                parts: Column::create(&spool.folder)?,
                textured: Column::create(&spool.folder)?,
            });
            self.flush(false)?;
            self.tail.positions.shrink_to(TAIL);
            self.tail.triangles.shrink_to(TAIL);
            self.tail.parts.shrink_to(TAIL);
            return Ok(());
        }
        self.flush(false)
    }

    /// Moves the tail into the files: all but the last part, which may still grow, and, unless it is the
    /// `end`, whole pages of vertices only, so that a page in the cache is complete for good.
    fn flush(&mut self, end: bool) -> Result<(), SceneError> {
        let Some(files) = &mut self.files else { return Ok(()) };
        let n = self.tail.positions.len();
        let whole = if end { n } else { n / PAGE * PAGE };
        files.positions.append(&self.tail.positions[..whole], &files.folder)?;
        files.triangles.append(&self.tail.triangles, &files.folder)?;
        self.tail.positions.drain(..whole);
        self.tail.triangles.clear();
        files.textured.append(&self.tail.textured, &files.folder)?;
        self.tail.textured.clear();
        if let Some(last) = self.tail.parts.pop() {
            files.append_parts(&self.tail.parts)?;
            self.tail.parts.clear();
            self.tail.parts.push(last);
        }
        Ok(())
    }

    /// The mesh, complete.
    pub(crate) fn finish(mut self) -> Result<Shape, SceneError> {
        self.check()?;
        self.flush(true)?;
        Ok(match self.files {
            Some(mut files) => {
                files.append_parts(&self.tail.parts)?;
                Shape::Spooled(files)
            }
            None => {
                self.tail.positions.shrink_to_fit();
                self.tail.triangles.shrink_to_fit();
                self.tail.parts.shrink_to_fit();
                self.tail.textured.shrink_to_fit();
                Shape::Resident(self.tail)
            }
        })
    }
}

impl Resident {
    fn used_bytes(&self) -> u64 {
        (self.positions.len() * size_of::<Position>()
            + self.triangles.len() * 12
            + self.textured.len() * size_of::<Textured>()
            + self.parts.len() * size_of::<Part>()) as u64
    }
}

impl Spooled {
    fn append_parts(&mut self, parts: &[Part]) -> Result<(), SceneError> {
        let mut packed: Vec<[u32; 4]> = Vec::with_capacity(parts.len().min(TAIL));
        for some in parts.chunks(TAIL) {
            packed.clear();
            packed.extend(some.iter().map(|p| p.pack()));
            self.parts.append(&packed, &self.folder)?;
        }
        Ok(())
    }
}

impl Spooled {
    /// Number of the first coordinates of triangle `t` or later ones.
    fn first_textured(&self, t: u32) -> Result<u64, SceneError> {
        let (mut low, mut high) = (0, self.textured.len);
        let mut one: Vec<Textured> = Vec::new();
        while low < high {
            let middle = low + (high - low) / 2;
            self.textured.read(middle, 1, &mut one, &self.folder)?;
            if one.first().is_some_and(|c| c.triangle < t) {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        Ok(low)
    }
}

impl Default for Shape {
    fn default() -> Self {
        Self::Resident(Resident::default())
    }
}

impl Shape {
    /// Heap bytes.
    pub(crate) fn bytes(&self) -> u64 {
        match self {
            Self::Resident(r) => {
                (r.positions.capacity() * size_of::<Position>()
                    + r.triangles.capacity() * 12
                    + r.textured.capacity() * size_of::<Textured>()
                    + r.parts.capacity() * size_of::<Part>()) as u64
            }
            Self::Spooled(s) => s.folder.as_os_str().len() as u64,
        }
    }

    /// Number of triangles.
    pub(crate) fn triangles(&self) -> u64 {
        match self {
            Self::Resident(r) => r.triangles.len() as u64,
            Self::Spooled(s) => s.triangles.len,
        }
    }

    /// The parts in order, each with its triangles.
    pub(crate) fn parts(&self) -> Parts<'_> {
        Parts { shape: self, next: 0, begin: 0, window: Vec::new(), first: 0 }
    }

    /// Replaces the parts: `each` turns one part and its triangles into any number of parts.
    pub(crate) fn rewrite_parts(
        &mut self,
        mut each: impl FnMut(&Self, Part, Range<u32>, &mut Vec<Part>) -> Result<(), SceneError>,
    ) -> Result<(), SceneError> {
        let mut out = Vec::new();
        let mut column = match self {
            Self::Resident(_) => None,
            Self::Spooled(s) => Some(Column::create(&s.folder)?),
        };
        for part in self.parts() {
            let (part, triangles) = part?;
            each(self, part, triangles, &mut out)?;
            if let (Some(column), Self::Spooled(s), true) = (&mut column, &*self, out.len() >= TAIL)
            {
                // The last may still grow.
                let last = out.pop();
                let packed: Vec<[u32; 4]> = out.iter().map(|p| p.pack()).collect();
                column.append(&packed, &s.folder)?;
                out.clear();
                out.extend(last);
            }
        }
        match self {
            Self::Resident(r) => {
                out.shrink_to_fit();
                r.parts = out;
            }
            Self::Spooled(s) => {
                if let Some(column) = column {
                    s.parts = column;
                }
                s.append_parts(&out)?;
            }
        }
        Ok(())
    }
}

/// See [`Shape::parts`].
pub(crate) struct Parts<'a> {
    shape: &'a Shape,
    /// Number of the next part.
    next: u64,
    /// First triangle of the next part.
    begin: u32,
    /// Parts that were read from a file, from number `first` on.
    window: Vec<[u32; 4]>,
    first: u64,
}

impl Parts<'_> {
    fn part(&mut self) -> Result<Option<Part>, SceneError> {
        match self.shape {
            Shape::Resident(r) => Ok(r.parts.get(self.next as usize).copied()),
            Shape::Spooled(s) => {
                if self.next >= s.parts.len {
                    return Ok(None);
                }
                if self.next - self.first >= self.window.len() as u64 {
                    self.first = self.next;
                    s.parts.read(self.first, WINDOW, &mut self.window, &s.folder)?;
                }
                Ok(self.window.get((self.next - self.first) as usize).map(|&p| Part::unpack(p)))
            }
        }
    }
}

impl Iterator for Parts<'_> {
    type Item = Result<(Part, Range<u32>), SceneError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.part() {
            Ok(Some(part)) => {
                let triangles = self.begin..part.end;
                self.begin = part.end;
                self.next += 1;
                Some(Ok((part, triangles)))
            }
            Ok(None) => None,
            Err(e) => {
                self.next = u64::MAX;
                Some(Err(e))
            }
        }
    }
}

/// Vertices of a spooled mesh, read page by page, made into `T` on the way. Which page goes is decided by
/// the clock rule: one that was used since the hand last passed gets another round.
#[derive(Default)]
struct Pages<T> {
    items: Vec<T>,
    /// Slot of each page of the mesh.
    slot_of: Vec<u16>,
    /// Page in each slot, and whether it was used.
    slots: Vec<(u32, bool)>,
    hand: usize,
    raw: Vec<Position>,
}

impl<T: Copy> Pages<T> {
    /// Forgets everything; the memory stays.
    fn reset(&mut self) {
        self.items.clear();
        self.slots.clear();
        self.slot_of.clear();
        self.hand = 0;
    }

    #[inline]
    fn get(
        &mut self,
        from: &Spooled,
        vertex: u32,
        make: impl Fn(Position) -> T,
    ) -> Result<T, SceneError> {
        let page = vertex as usize / PAGE;
        let mut slot = self.slot_of.get(page).copied().unwrap_or(ABSENT);
        if slot == ABSENT {
            slot = self.load(from, page, make)?;
        }
        let slot = usize::from(slot);
        self.slots[slot].1 = true;
        Ok(self.items[slot * PAGE + vertex as usize % PAGE])
    }

    #[cold]
    fn load(
        &mut self,
        from: &Spooled,
        page: usize,
        make: impl Fn(Position) -> T,
    ) -> Result<u16, SceneError> {
        if self.slot_of.len() <= page {
            self.slot_of.resize(page + 1, ABSENT);
        }
        from.positions.read((page * PAGE) as u64, PAGE, &mut self.raw, &from.folder)?;
        // The last page is filled up; a vertex beyond it is never asked for.
        self.raw.resize(PAGE, [f64::NAN; 3]);
        let slot = if self.slots.len() < PAGES {
            self.slots.push((page as u32, true));
            self.items.extend(self.raw.iter().map(|&p| make(p)));
            self.slots.len() - 1
        } else {
            while std::mem::take(&mut self.slots[self.hand].1) {
                self.hand = (self.hand + 1) % PAGES;
            }
            let slot = self.hand;
            self.hand = (self.hand + 1) % PAGES;
            self.slot_of[self.slots[slot].0 as usize] = ABSENT;
            self.slots[slot] = (page as u32, true);
            for (to, &p) in self.items[slot * PAGE..].iter_mut().zip(&self.raw) {
                *to = make(p);
            }
            slot
        };
        self.slot_of[page] = slot as u16;
        Ok(slot as u16)
    }
}

/// Triangles of a mesh, looked up with their vertices made into `T`; what it keeps of a spooled mesh is
/// less than 7 MiB, of a resident one nothing.
pub(crate) struct Lookup<T> {
    window: Vec<[u32; 3]>,
    first: u64,
    /// Texture coordinates that were read, from number `textured_first` on.
    textured: Vec<Textured>,
    textured_first: u64,
    pages: Pages<T>,
}

impl<T> Default for Lookup<T> {
    fn default() -> Self {
        let pages = Pages {
            items: Vec::new(),
            slot_of: Vec::new(),
            slots: Vec::new(),
            hand: 0,
            raw: Vec::new(),
        };
        Self { window: Vec::new(), first: 0, textured: Vec::new(), textured_first: 0, pages }
    }
}

impl<T: Copy> Lookup<T> {
    /// Must be called before another mesh, or another way to make a `T`.
    pub(crate) fn reset(&mut self) {
        self.window.clear();
        self.first = 0;
        self.textured.clear();
        self.textured_first = 0;
        self.pages.reset();
    }

    /// Texture coordinates of a triangle, if it has any.
    pub(crate) fn coordinates(
        &mut self,
        shape: &Shape,
        t: u32,
    ) -> Result<Option<[[f32; 2]; 3]>, SceneError> {
        let find = |list: &[Textured]| {
            let at = list.binary_search_by_key(&t, |c| c.triangle).ok()?;
            Some(list[at].corners)
        };
        let s = match shape {
            Shape::Resident(r) => return Ok(find(&r.textured)),
            Shape::Spooled(s) => s,
        };
        let covers = |list: &[Textured]| {
            list.first().is_some_and(|c| c.triangle <= t)
                && list.last().is_some_and(|c| t <= c.triangle)
        };
        if !covers(&self.textured) {
            // What follows is the likely place; else it is looked for.
            let mut next = self.textured_first + self.textured.len() as u64;
            if self.textured.last().is_none_or(|c| c.triangle >= t) {
                next = s.first_textured(t)?;
            }
            for _ in 0..2 {
                self.textured_first = next;
                s.textured.read(next, WINDOW, &mut self.textured, &s.folder)?;
                if covers(&self.textured) {
                    break;
                }
                next = s.first_textured(t)?;
            }
        }
        Ok(find(&self.textured))
    }

    /// Vertex numbers of a triangle.
    #[inline]
    pub(crate) fn triangle(&mut self, shape: &Shape, t: u32) -> Result<[u32; 3], SceneError> {
        match shape {
            Shape::Resident(r) => Ok(r.triangles[t as usize]),
            Shape::Spooled(s) => {
                let t = u64::from(t);
                if t < self.first || t - self.first >= self.window.len() as u64 {
                    self.first = t;
                    s.triangles.read(t, WINDOW, &mut self.window, &s.folder)?;
                }
                Ok(self.window[(t - self.first) as usize])
            }
        }
    }

    /// A vertex.
    #[inline]
    pub(crate) fn vertex(
        &mut self,
        shape: &Shape,
        vertex: u32,
        make: impl Fn(Position) -> T,
    ) -> Result<T, SceneError> {
        match shape {
            Shape::Resident(r) => Ok(make(r.positions[vertex as usize])),
            Shape::Spooled(s) => self.pages.get(s, vertex, make),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mesh that refers to vertices all over the place, in parts of odd lengths, eleven triangles for six
    /// vertices. Whatever was pushed can be looked up at any time.
    fn build(spool: Option<&Spool>, n: u32) -> Shape {
        let mut b = Builder::new(spool);
        for i in 0..n {
            b.push_vertex([f64::from(i), 0.5, -f64::from(i)]).unwrap();
            for _ in 0..if i < 2 { 0 } else { 1 + u32::from(i % 2 == 0) + u32::from(i % 3 == 0) } {
                let far = i.wrapping_mul(2_654_435_761) % i;
                let part = Part { end: 0, object: i / 7, material: i % 3, door: i % 5 == 0 };
                b.push_triangle([i, i - 1, far], part).unwrap();
                if i % 4 != 1 {
                    b.push_coordinates([[i as f32, 0.0], [0.0, 1.0], [0.5, 0.5]]).unwrap();
                }
                for v in [far, i - 1, i.saturating_sub(900), i.saturating_sub(9000)] {
                    assert_eq!(b.position(v).unwrap().unwrap()[0], f64::from(v));
                }
            }
        }
        assert_eq!(b.position(n).unwrap(), None);
        b.finish().unwrap()
    }

    #[test]
    fn spooled_and_resident_are_the_same() {
        let dir = tempfile::tempdir().unwrap();
        let spool = Spool { folder: dir.path().into(), above: 1 << 20 };
        // Fewer vertices than the cache holds: nothing that was ever in it goes.
        drop(build(Some(&spool), 200_000));
        let (a, b) = (build(None, 700_000), build(Some(&spool), 700_000));
        assert!(matches!(a, Shape::Resident(_)) && matches!(b, Shape::Spooled(_)));
        assert!(b.bytes() < 4096, "{}", b.bytes());
        assert_eq!(a.triangles(), b.triangles());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "the files have no names");
        let parts = |s: &Shape| s.parts().map(Result::unwrap).collect::<Vec<_>>();
        assert_eq!(parts(&a), parts(&b));
        let (mut x, mut y) = (Lookup::<Position>::default(), Lookup::<Position>::default());
        let count = parts(&a).last().unwrap().1.end;
        assert_eq!(count, 699_998 + 349_999 + 233_333);
        for t in (0..count).chain([0, 5, count - 1]) {
            let (p, q) = (x.triangle(&a, t).unwrap(), y.triangle(&b, t).unwrap());
            assert_eq!(p, q);
            let coordinates = x.coordinates(&a, t).unwrap();
            assert_eq!(coordinates, y.coordinates(&b, t).unwrap());
            assert_eq!(coordinates.map(|c| c[0][0]), (p[0] % 4 != 1).then_some(p[0] as f32));
            for v in p {
                assert_eq!(x.vertex(&a, v, |p| p).unwrap(), y.vertex(&b, v, |p| p).unwrap());
            }
        }
        assert!(y.pages.items.len() <= PAGES * PAGE);
    }

    #[test]
    fn parts_are_rewritten_alike() {
        let dir = tempfile::tempdir().unwrap();
        let spool = Spool { folder: dir.path().into(), above: 1 << 20 };
        let cut = |mut s: Shape| {
            s.rewrite_parts(|_, part, triangles, out| {
                out.extend(triangles.map(|t| Part { end: t + 1, object: part.object + 1, ..part }));
                Ok(())
            })
            .unwrap();
            s.parts().map(Result::unwrap).collect::<Vec<_>>()
        };
        assert_eq!(cut(build(None, 100_000)), cut(build(Some(&spool), 100_000)));
    }

    #[test]
    fn a_folder_that_is_not_there_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let spool = Spool { folder: dir.path().join("not/there"), above: 0 };
        let mut b = Builder::new(Some(&spool));
        b.push_vertex([0.0; 3]).unwrap();
        let error = b.finish().unwrap_err();
        assert_eq!(error.exit_code(), 5);
        assert!(error.to_string().contains("not/there"), "{error}");
    }
}
