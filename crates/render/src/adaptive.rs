//! Where a picture needs more camera rays: pixels whose first ones differ by too much (Mitchell 1987, "Generating
//! Antialiased Images at Low Sampling Densities", with the error itself in place of contrast).
//!
//! Every second of a pixel's first samples counts negative; what that leaves of its luminance is how far the two halves are
//! apart. It is a sum of integers, like all that the film holds, and so the decision is the same whatever the budget, threads
//! and tiles. Light that gather rays find is left out: it is smooth, and averaged over neighbours anyway.

use enf_image::Film;

use crate::RenderArgs;
use crate::shade::Context;

/// Bytes per pixel that decisions take: a number and an error, the samples, and those before.
pub(crate) const BYTES_PER_PIXEL: usize = 8 + 8 + 4 + 4 + 8;

/// Pixels darker than this share of the mean are held to the error of one that is not.
const DARK: f64 = 0.15;

/// How many samples more each pixel of a band gets, after all have had the same.
pub(crate) fn more(
    film: &Film,
    context: &Context<'_>,
    first_pixel: u32,
    args: &RenderArgs,
) -> Vec<u32> {
    let first = f64::from(context.samples);
    let count = film.len();
    let luminance: Vec<f64> = (0..count).map(|p| film.luminance(p) / first).collect();
    let mean = luminance.iter().sum::<f64>() / count.max(1) as f64;
    let squares: Vec<f64> = (0..count).map(|p| (film.noise(p) / first).powi(2)).collect();
    (0..count)
        .map(|pixel| {
            // A pixel's neighbours decide, not the pixel: its own samples then know nothing of how many they will be, and
            // their mean is as unbiased as before. (If they did, one that by chance has seen nothing bright would stop early.)
            let (mut error, mut light, mut pixels) = (0.0, 0.0, 0.0);
            context.neighbours(first_pixel, count, pixel, 1, |other, _| {
                if other != pixel {
                    error += squares[other];
                    light += luminance[other];
                    pixels += 1.0;
                }
            });
            let allowed = f64::from(args.noise) * (light / pixels).max(mean * DARK);
            let wanted = first * (error / pixels) / (allowed * allowed);
            // No light, no error: no number.
            if wanted > first {
                ((wanted - first).ceil() as u32).min(args.more_samples())
            } else {
                0
            }
        })
        .collect()
}
