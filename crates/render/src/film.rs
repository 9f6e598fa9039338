//! Developing: finished bands become picture files, a few rows at a time.

use enf_image::{
    ImageError, Rows, RowsError, exposure_from, falsecolour_png_from, write_exr_from,
    write_hdr_from, write_png_toned,
};
use enf_layout::film::PixelRecord;
use enf_layout::segment::{ExtentKind, StageKind};
use enf_stage::{ExitStatus, Failure, Result, interrupt};
use enf_store::{Buffer, MemoryBudget, StageReader, StoreDir, StoreError};

use crate::{BAND_PIXELS, Exposure, Format, Output, RenderArgs, View};

/// A view's rows, read from the bands of the store.
struct FilmRows<'a> {
    reader: &'a StageReader,
    budget: &'a MemoryBudget,
    width: u32,
    height: u32,
    first_pixel: u32,
    /// The band read last.
    band: Option<(u32, Buffer)>,
}

impl Rows for FilmRows<'_> {
    fn width(&self) -> u32 {
        self.width
    }

    fn height(&self) -> u32 {
        self.height
    }

    fn read(
        &mut self,
        first_row: u32,
        out: &mut [PixelRecord],
    ) -> std::result::Result<(), RowsError> {
        let mut pixel = self.first_pixel + first_row * self.width;
        if interrupt::interrupted().is_some() {
            return Err("the program was asked to stop".into());
        }
        let mut out = out;
        while !out.is_empty() {
            let band = pixel / BAND_PIXELS;
            if self.band.as_ref().is_none_or(|b| b.0 != band) {
                self.band = None;
                let extent = self.reader.single(ExtentKind::Film, band)?;
                self.band = Some((band, self.reader.read(extent, self.budget, "film")?));
            }
            let Some((_, buffer)) = &self.band else { break };
            let records = buffer.as_slice_of::<PixelRecord>().map_err(StoreError::from)?;
            let from = (pixel % BAND_PIXELS) as usize;
            let count = out.len().min(records.len().saturating_sub(from));
            if count == 0 {
                return Err("a band of the film is too short".into());
            }
            let (now, later) = out.split_at_mut(count);
            now.copy_from_slice(&records[from..from + count]);
            pixel += count as u32;
            out = later;
        }
        Ok(())
    }
}

/// Bytes that [`develop`] needs for pictures of this width at most: what the writers take, and a band of the film.
pub(crate) fn writer_bytes(width: u32) -> u64 {
    enf_image::scratch_bytes(width) as u64
        + u64::from(BAND_PIXELS) * size_of::<PixelRecord>() as u64
        + (64 << 10)
}

/// Writes the files of every view.
pub(crate) fn develop(
    store: &StoreDir,
    budget: &MemoryBudget,
    views: &[View],
    pictures: &[Vec<Output>],
    args: &RenderArgs,
) -> Result<()> {
    let reader = StageReader::open(store, StageKind::Render)?;
    let mut first_pixel = 0;
    for (view, files) in views.iter().zip(pictures) {
        let _scratch = budget
            .reserve(enf_image::scratch_bytes(view.camera.width) as u64, "picture writers")?;
        let mut rows = FilmRows {
            reader: &reader,
            budget,
            width: view.camera.width,
            height: view.camera.height,
            first_pixel,
            band: None,
        };
        for file in files {
            write(file, &mut rows, args).map_err(failure)?;
        }
        first_pixel += view.camera.pixels();
    }
    Ok(())
}

/// A film that cannot be read is the store's failure, whatever picture it was for.
fn failure(error: ImageError) -> Failure {
    if let (ImageError::Rows { .. }, Some(signal)) = (&error, interrupt::interrupted()) {
        return Failure::interrupted(signal);
    }
    let code = match &error {
        ImageError::Rows { source, .. } => source.downcast_ref::<StoreError>(),
        _ => None,
    };
    let code = code.map_or(ExitStatus::Io, |e| ExitStatus::from_code(e.exit_code()));
    Failure::new(code, error.to_string())
}

fn write(
    file: &Output,
    rows: &mut FilmRows<'_>,
    args: &RenderArgs,
) -> std::result::Result<(), ImageError> {
    let path = &file.path;
    match file.format {
        Format::Exr => write_exr_from(path, rows),
        Format::Hdr => write_hdr_from(path, rows),
        Format::Falsecolour => falsecolour_png_from(path, rows, args.falsecolour_max),
        Format::Png => {
            let exposure = match args.exposure {
                Exposure::Factor(factor) => factor,
                Exposure::Auto => exposure_from(path, rows)?,
            };
            write_png_toned(path, rows, exposure, args.tone.into())
        }
    }
}
