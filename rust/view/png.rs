//! A PNG writer.

use super::Image;
use crate::error::{Error, Result};
use flate2::{Compression, Crc, write::ZlibEncoder};
use std::io::Write;

fn chunk(out: &mut Vec<u8>, kind: &[u8; 4], body: &[u8]) {
    let mut crc = Crc::new();
    crc.update(kind);
    crc.update(body);
    out.extend((body.len() as u32).to_be_bytes());
    out.extend(kind);
    out.extend(body);
    out.extend(crc.sum().to_be_bytes());
}

fn paeth(a: u8, b: u8, c: u8) -> u8 {
    let (x, y, z) = (i16::from(a), i16::from(b), i16::from(c));
    let (da, db, dc) = ((y - z).abs(), (x - z).abs(), (x + y - 2 * z).abs());
    if da <= db && da <= dc {
        a
    } else if db <= dc {
        b
    } else {
        c
    }
}

impl Image {
    /// The picture as a PNG file.
    ///
    /// ```
    /// let image = beltrami::view::Image::new(1, 1, vec![1, 2, 3])?;
    /// assert_eq!(image.to_png()?[..4], *b"\x89PNG");
    /// # Ok::<(), beltrami::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Input`] if a side has more than 2^31 - 1 pixels; [`Error::Numerical`] if the compressor fails.
    pub fn to_png(&self) -> Result<Vec<u8>> {
        let side = |n: usize| i32::try_from(n).map_err(|_| Error::input(format!("a side of {n} pixels; PNG allows 2^31 - 1")));
        let (width, height, row) = (side(self.width)?, side(self.height)?, 3 * self.width);
        let broken = |error: std::io::Error| Error::numerical(format!("the picture cannot be compressed: {error}"));
        let mut encoder = ZlibEncoder::new(Vec::with_capacity(self.pixels.len() / 8), Compression::new(5));
        let blank = vec![0; row];
        let mut trial = vec![0; row];
        let mut best = vec![0; row];
        for y in 0..self.height {
            let line = &self.pixels[y * row..][..row];
            let above = if y == 0 { &blank[..] } else { &self.pixels[(y - 1) * row..][..row] };
            let mut least = u64::MAX;
            let mut kind = 0;
            for filter in [1u8, 2, 4] {
                for x in 0..row {
                    let (left, corner) = if x < 3 { (0, 0) } else { (line[x - 3], above[x - 3]) };
                    trial[x] = line[x].wrapping_sub(match filter {
                        1 => left,
                        2 => above[x],
                        _ => paeth(left, above[x], corner),
                    });
                }
                // The usual rule: the filter whose bytes, taken as signed, are smallest in sum.
                let sum = trial.iter().map(|&byte| u64::from((byte as i8).unsigned_abs())).sum();
                if sum < least {
                    least = sum;
                    kind = filter;
                    std::mem::swap(&mut best, &mut trial);
                }
            }
            encoder.write_all(&[kind]).map_err(broken)?;
            encoder.write_all(&best).map_err(broken)?;
        }
        let body = encoder.finish().map_err(broken)?;
        let mut out = Vec::with_capacity(body.len() + 128);
        out.extend(b"\x89PNG\r\n\x1a\n");
        let mut header = Vec::with_capacity(13);
        header.extend(width.to_be_bytes());
        header.extend(height.to_be_bytes());
        header.extend([8, 2, 0, 0, 0]); // 8 bits, red green blue, deflate, adaptive filters, not interlaced
        chunk(&mut out, b"IHDR", &header);
        chunk(&mut out, b"sRGB", &[0]);
        chunk(&mut out, b"IDAT", &body);
        chunk(&mut out, b"IEND", &[]);
        Ok(out)
    }
}
