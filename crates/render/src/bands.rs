//! The bands of pixels under way: their films, how far each is, and when one is done.
//!
//! Several bands are under way at a time. So the last rays of one, which wander from room to room, fly beside the first ones of
//! the next, and a tile that has to be loaded answers the rays of all of them. A band's pass is over when none of its rays flies,
//! waits, or has still to be sent off; that is counted.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use enf_image::{Film, Gathered};
use enf_layout::film::PixelRecord;
use enf_layout::transit::TransitRecord;
use enf_store::{BudgetError, MemoryBudget, Reservation};

use crate::adaptive;
use crate::shade::{Context, Pass};
use crate::{BAND_PIXELS, RenderArgs};

/// Bytes of a band's film, and of what is made of it.
pub(crate) fn bytes(pixels: u32) -> u64 {
    (film_bytes_per_pixel() + rest_bytes_per_pixel()) * u64::from(pixels)
}

fn film_bytes_per_pixel() -> u64 {
    Film::bytes_per_pixel() as u64
}

fn rest_bytes_per_pixel() -> u64 {
    (size_of::<PixelRecord>() + size_of::<Gathered>() + adaptive::BYTES_PER_PIXEL) as u64
}

/// The band of a pixel.
pub(crate) fn band_of(pixel: u32) -> u32 {
    pixel / BAND_PIXELS
}

/// A band's film with its bytes.
struct BandFilm {
    film: Film,
    _reservation: Reservation,
}

/// The films of the bands under way.
pub(crate) struct Films {
    first_band: u32,
    films: Vec<Option<Arc<BandFilm>>>,
    /// For pixels of no such band; there are none.
    none: Film,
}

impl Films {
    /// The film of a pixel, counted over all views, and its number there.
    #[inline]
    pub(crate) fn of(&self, pixel: u32) -> (&Film, u32) {
        let at = band_of(pixel).wrapping_sub(self.first_band) as usize;
        match self.films.get(at) {
            Some(Some(band)) => (&band.film, pixel % BAND_PIXELS),
            _ => (&self.none, 0),
        }
    }
}

/// How many rays of which band are more, or fewer, after a job.
#[derive(Default)]
pub(crate) struct Lives(Vec<(u32, i64)>);

impl Lives {
    /// Counts rays of a band.
    pub(crate) fn add(&mut self, band: u32, rays: i64) {
        match self.0.iter_mut().rfind(|lives| lives.0 == band) {
            Some(lives) => lives.1 += rays,
            None => self.0.push((band, rays)),
        }
    }

    /// Counts each of some rays so often.
    pub(crate) fn add_all(&mut self, records: &[TransitRecord], each: i64) {
        for run in records.chunk_by(|a, b| band_of(a.light) == band_of(b.light)) {
            self.add(band_of(run[0].light), each * run.len() as i64);
        }
    }
}

/// Where a view's camera rays start from: the tile of its eye. Those of an eye in a doorway, or of a plan, are
/// parked from there at the tiles that they start in.
pub(crate) struct Launch {
    pub(crate) tile: u32,
    /// Rays of the pass, all of one view.
    pub(crate) left: Range<u64>,
}

/// One band at work.
pub(crate) struct Band {
    film: Arc<BandFilm>,
    /// For what is made of the film.
    rest: Reservation,
    pub(crate) first_pixel: u32,
    pub(crate) pixels: u32,
    pub(crate) pass: Pass,
    /// Camera rays of the pass that have still to be sent off.
    pub(crate) launches: Vec<Launch>,
    /// Rays that fly, wait, or have still to be sent off.
    alive: i64,
}

/// A band that is done.
pub(crate) struct Exposed {
    pub(crate) records: Vec<PixelRecord>,
    pub(crate) gathered: Vec<Gathered>,
    /// Contributions that were no numbers, and are left out.
    pub(crate) not_finite: u64,
    /// Of their bytes.
    pub(crate) reservation: Reservation,
}

/// What the end of a pass leads to.
pub(crate) enum After {
    /// Another pass, which has been begun.
    Pass,
    /// The band is done.
    Done(Exposed),
}

/// See the module.
pub(crate) struct Bands {
    under_way: BTreeMap<u32, Band>,
    films: Arc<Films>,
}

impl Bands {
    pub(crate) fn new() -> Self {
        let films = Films { first_band: 0, films: Vec::new(), none: Film::new(0) };
        Self { under_way: BTreeMap::new(), films: Arc::new(films) }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.under_way.is_empty()
    }

    /// Bands under way.
    pub(crate) fn len(&self) -> usize {
        self.under_way.len()
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &Band> {
        self.under_way.values()
    }

    /// The films for a job.
    pub(crate) fn films(&self) -> Arc<Films> {
        Arc::clone(&self.films)
    }

    /// Begins a band of so many pixels.
    ///
    /// # Errors
    /// When the budget has no room for it.
    pub(crate) fn begin(
        &mut self,
        band: u32,
        pixels: u32,
        context: &Context<'_>,
        budget: &MemoryBudget,
    ) -> Result<(), BudgetError> {
        let pixels_u64 = u64::from(pixels);
        let reservation = budget.reserve(film_bytes_per_pixel() * pixels_u64, "film")?;
        let rest = budget.reserve(rest_bytes_per_pixel() * pixels_u64, "developed pixels")?;
        let film = Film::new(pixels as usize);
        let mut new = Band {
            film: Arc::new(BandFilm { film, _reservation: reservation }),
            rest,
            first_pixel: band * BAND_PIXELS,
            pixels,
            pass: Pass::All,
            launches: Vec::new(),
            alive: 0,
        };
        new.launch(context);
        self.under_way.insert(band, new);
        self.show();
        Ok(())
    }

    /// Counts what a job has brought.
    pub(crate) fn count(&mut self, lives: &Lives) {
        for &(band, rays) in &lives.0 {
            if let Some(band) = self.under_way.get_mut(&band) {
                band.alive += rays;
            }
        }
    }

    /// A band that has no ray left, the lowest.
    pub(crate) fn over(&self) -> Option<u32> {
        self.under_way.iter().find(|(_, band)| band.alive == 0).map(|(&band, _)| band)
    }

    /// The first launch that may be sent off now: of up to `most` rays, the band's first pixel, its pass and the rays.
    pub(crate) fn launch(
        &mut self,
        most: u64,
        may: impl Fn(u32) -> bool,
    ) -> Option<(u32, u32, Pass, Range<u64>)> {
        self.under_way.values_mut().find_map(|band| {
            let launch = band.launches.iter_mut().find(|l| !l.left.is_empty() && may(l.tile))?;
            let stop = (launch.left.start + most).min(launch.left.end);
            let rays = launch.left.start..stop;
            launch.left.start = stop;
            Some((launch.tile, band.first_pixel, band.pass.clone(), rays))
        })
    }

    /// Rays of a band that have still to be sent off, by tile.
    pub(crate) fn launches(&self, band: u32) -> impl Iterator<Item = (u32, u64)> + '_ {
        let launches = self.under_way.get(&band).into_iter().flat_map(|band| &band.launches);
        launches.map(|l| (l.tile, l.left.end - l.left.start))
    }

    /// Camera rays of the first passes that have been sent off, and all of bands that are further.
    pub(crate) fn sent(&self, samples: u64) -> u64 {
        self.iter()
            .map(|band| {
                let all = u64::from(band.pixels) * samples;
                match band.pass {
                    Pass::More(_) => all,
                    Pass::All => {
                        let left: u64 =
                            band.launches.iter().map(|l| l.left.end - l.left.start).sum();
                        all - left.min(all)
                    }
                }
            })
            .sum()
    }

    /// Ends the pass of a band that has no ray left.
    pub(crate) fn end_pass(
        &mut self,
        number: u32,
        context: &Context<'_>,
        args: &RenderArgs,
    ) -> Option<After> {
        let band = self.under_way.get_mut(&number)?;
        let film = &band.film.film;
        if matches!(band.pass, Pass::All) && args.more_samples() > 0 {
            let more = adaptive::more(film, context, band.first_pixel, args);
            let mut before = Vec::with_capacity(more.len() + 1);
            let mut sum = 0;
            before.push(sum);
            for more in more {
                sum += u64::from(more);
                before.push(sum);
            }
            band.pass = Pass::More(Arc::new(before));
            if sum > 0 {
                band.launch(context);
                return Some(After::Pass);
            }
        }
        let band = self.under_way.remove(&number)?;
        self.show();
        Some(After::Done(band.develop(context, args)))
    }

    /// Gives the jobs to come the films that there are.
    fn show(&mut self) {
        let first_band = self.under_way.keys().next().copied().unwrap_or(0);
        let end = self.under_way.keys().next_back().map_or(0, |&last| last + 1);
        let film = |band: u32| self.under_way.get(&band).map(|band| Arc::clone(&band.film));
        let films = (first_band..end).map(film).collect();
        self.films = Arc::new(Films { first_band, films, none: Film::new(0) });
    }
}

impl Band {
    /// Makes ready the rays of a pass.
    fn launch(&mut self, context: &Context<'_>) {
        let samples = u64::from(context.samples);
        let before = |pixel: u32| match &self.pass {
            Pass::All => u64::from(pixel) * samples,
            Pass::More(before) => before[pixel as usize],
        };
        self.launches.clear();
        for (i, view) in context.views.iter().enumerate() {
            let (first, end) = (context.first_pixels[i], context.first_pixels[i + 1]);
            let first = first.max(self.first_pixel);
            let end = end.min(self.first_pixel + self.pixels);
            if first >= end {
                continue;
            }
            let left = before(first - self.first_pixel)..before(end - self.first_pixel);
            if left.is_empty() {
                continue;
            }
            let leaf = context.bsp.locate(view.camera.eye.as_dvec3());
            let tile = context.bsp.leaves[leaf as usize].tile;
            self.alive += (left.end - left.start) as i64;
            self.launches.push(Launch { tile, left });
        }
    }

    fn develop(self, context: &Context<'_>, args: &RenderArgs) -> Exposed {
        let film = &self.film.film;
        let more = |pixel: usize| match &self.pass {
            Pass::All => 0,
            Pass::More(before) => (before[pixel + 1] - before[pixel]) as u32,
        };
        let gathering = context.samples;
        let mut records = vec![PixelRecord::default(); self.pixels as usize];
        film.resolve_each(0, |pixel| context.samples + more(pixel), gathering, &mut records);
        let gathered = match args.smooths() {
            true => (0..self.pixels as usize).map(|p| film.gathered(p, gathering)).collect(),
            false => Vec::new(),
        };
        Exposed { records, gathered, not_finite: film.rejected(), reservation: self.rest }
    }
}
