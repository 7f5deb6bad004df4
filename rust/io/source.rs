//! Bytes of a file as they come: plain or gzip, in pieces or all at once, never more memory than there are bytes.

use crate::control::Control;
use crate::error::{Error, Place};
use flate2::read::MultiGzDecoder;
use std::fs::File;
use std::io::{Cursor, Read};
use std::path::Path;

const BLOCK: usize = 1 << 18;
const PIECE: usize = 16 << 20; // read between looks at the control
const GZIP: [u8; 2] = [0x1f, 0x8b];
// A deflate stream can grow a thousandfold; shapes compress to a tenth at best, tables of zeros to a hundredth.
const GROWTH: usize = 250;
const GROWTH_FREE: usize = 64 << 20;

/// Why reading ended early.
#[derive(Debug)]
pub(super) enum Stop {
    At(Place, String),
    Cancelled,
}

pub(super) type Parsed<T> = Result<T, Stop>;

impl From<Error> for Stop {
    fn from(error: Error) -> Self {
        match error {
            Error::Cancelled => Stop::Cancelled,
            other => Stop::At(Place::Whole, other.to_string()),
        }
    }
}

impl Stop {
    pub(super) fn line<T>(line: usize, cause: impl Into<String>) -> Parsed<T> {
        Err(Stop::At(Place::Line(line), cause.into()))
    }

    pub(super) fn byte<T>(byte: usize, cause: impl Into<String>) -> Parsed<T> {
        Err(Stop::At(Place::Byte(byte), cause.into()))
    }

    pub(super) fn whole<T>(cause: impl Into<String>) -> Parsed<T> {
        Err(Stop::At(Place::Whole, cause.into()))
    }

    pub(super) fn within(self, path: &Path) -> Error {
        match self {
            Stop::At(place, cause) => Error::File { path: path.to_path_buf(), place, cause },
            Stop::Cancelled => Error::Cancelled,
        }
    }
}

/// A vector with room for `count` entries, or an error instead of an abort where memory does not reach.
pub(super) fn reserved<T>(count: usize) -> Parsed<Vec<T>> {
    let mut vector = Vec::new();
    match vector.try_reserve_exact(count) {
        Ok(()) => Ok(vector),
        Err(_) => Stop::whole(format!("{} MB of memory are needed and not to be had", (count * size_of::<T>()) >> 20)),
    }
}

/// A window on a stream of bytes.
pub(super) struct Source<'a> {
    reader: Box<dyn Read + 'a>,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    before: usize, // bytes of the stream before the buffer
    length: Option<usize>,
    most: usize,
    ended: bool,
    control: &'a Control,
}

impl<'a> Source<'a> {
    pub(super) fn file(path: &Path, control: &'a Control) -> Parsed<Self> {
        let refuse = |error: std::io::Error| Stop::At(Place::Whole, format!("cannot be read: {error}"));
        let file = File::open(path).map_err(refuse)?;
        let about = file.metadata().map_err(refuse)?;
        if about.is_dir() {
            return Stop::whole("is a folder; name a file");
        }
        let length = about.is_file().then_some(about.len() as usize);
        Self::new(Box::new(file), length, control)
    }

    pub(super) fn bytes(bytes: &'a [u8], control: &'a Control) -> Parsed<Self> {
        Self::new(Box::new(bytes), Some(bytes.len()), control)
    }

    fn new(reader: Box<dyn Read + 'a>, length: Option<usize>, control: &'a Control) -> Parsed<Self> {
        let mut source =
            Source { reader, buffer: Vec::new(), start: 0, end: 0, before: 0, length, most: usize::MAX, ended: false, control };
        if source.need(2)? && source.window()[..2] == GZIP {
            let head = Cursor::new(source.window().to_vec());
            let most = length.map_or(usize::MAX, |length| length.saturating_mul(GROWTH).saturating_add(GROWTH_FREE));
            let reader = Box::new(MultiGzDecoder::new(head.chain(source.reader)));
            source = Source { reader, buffer: Vec::new(), start: 0, end: 0, before: 0, length: None, most, ended: false, control };
        }
        Ok(source)
    }

    /// Bytes that are here and not yet taken.
    pub(super) fn window(&self) -> &[u8] {
        &self.buffer[self.start..self.end]
    }

    /// Offset of the window in the stream.
    pub(super) fn position(&self) -> usize {
        self.before + self.start
    }

    /// How many bytes are left, where that is known.
    pub(super) fn left(&self) -> Option<usize> {
        self.length.map(|length| length.saturating_sub(self.position()))
    }

    pub(super) fn take(&mut self, count: usize) {
        self.start = (self.start + count).min(self.end);
    }

    /// Whether the window holds `count` bytes after reading on as far as needed.
    pub(super) fn need(&mut self, count: usize) -> Parsed<bool> {
        if self.end - self.start >= count {
            return Ok(true);
        }
        self.buffer.copy_within(self.start..self.end, 0);
        self.before += self.start;
        self.end -= self.start;
        self.start = 0;
        while self.end < count && !self.ended {
            if self.buffer.len() < self.end + BLOCK {
                self.buffer.resize(self.end + BLOCK, 0);
            }
            match self.reader.read(&mut self.buffer[self.end..]) {
                Ok(0) => self.ended = true,
                Ok(read) => self.end += read,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Stop::byte(self.before + self.end, format!("cannot be read on: {error}")),
            }
            self.watch(self.before + self.end)?;
        }
        Ok(self.end >= count)
    }

    /// All bytes to the end.
    pub(super) fn rest(mut self) -> Parsed<Vec<u8>> {
        let mut all = reserved(self.left().unwrap_or(0).max(self.end - self.start) + 1)?;
        all.extend_from_slice(self.window());
        let before = self.position();
        loop {
            match self.reader.by_ref().take(PIECE as u64).read_to_end(&mut all) {
                Ok(0) => return Ok(all),
                Ok(_) => self.watch(before + all.len())?,
                Err(error) => return Stop::byte(before + all.len(), format!("cannot be read on: {error}")),
            }
        }
    }

    fn watch(&self, read: usize) -> Parsed<()> {
        if read > self.most {
            return Stop::byte(
                read,
                format!(
                    "unpacks to more than {} MB, {GROWTH} times its size: no gzip file of a shape does; unpack it first if it is right",
                    self.most >> 20
                ),
            );
        }
        match self.length {
            Some(length) if length > 0 => self.control.report((read as f64 / length as f64).min(1.0))?,
            _ => self.control.check()?,
        }
        Ok(())
    }
}
