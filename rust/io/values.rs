//! Columns of numbers of any type: what a file holds a vertex beside positions.

use bytemuck::Pod;

/// Numbers of one type.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)] // the names say all
pub enum Values {
    Bool(Vec<bool>),
    I8(Vec<i8>),
    U8(Vec<u8>),
    I16(Vec<i16>),
    U16(Vec<u16>),
    I32(Vec<i32>),
    U32(Vec<u32>),
    I64(Vec<i64>),
    U64(Vec<u64>),
    F32(Vec<f32>),
    F64(Vec<f64>),
}

/// Runs one expression for whatever type the numbers have.
macro_rules! with_values {
    ($values:expr, $vector:ident => $body:expr) => {
        match $values {
            $crate::io::Values::Bool($vector) => $body,
            $crate::io::Values::I8($vector) => $body,
            $crate::io::Values::U8($vector) => $body,
            $crate::io::Values::I16($vector) => $body,
            $crate::io::Values::U16($vector) => $body,
            $crate::io::Values::I32($vector) => $body,
            $crate::io::Values::U32($vector) => $body,
            $crate::io::Values::I64($vector) => $body,
            $crate::io::Values::U64($vector) => $body,
            $crate::io::Values::F32($vector) => $body,
            $crate::io::Values::F64($vector) => $body,
        }
    };
}
pub(super) use with_values;

/// The types a file can store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    pub(super) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::I64 | Scalar::U64 | Scalar::F64 => 8,
        }
    }

    pub(super) fn is_float(self) -> bool {
        matches!(self, Scalar::F32 | Scalar::F64)
    }

    pub(super) fn empty(self) -> Values {
        match self {
            Scalar::I8 => Values::I8(Vec::new()),
            Scalar::U8 => Values::U8(Vec::new()),
            Scalar::I16 => Values::I16(Vec::new()),
            Scalar::U16 => Values::U16(Vec::new()),
            Scalar::I32 => Values::I32(Vec::new()),
            Scalar::U32 => Values::U32(Vec::new()),
            Scalar::I64 => Values::I64(Vec::new()),
            Scalar::U64 => Values::U64(Vec::new()),
            Scalar::F32 => Values::F32(Vec::new()),
            Scalar::F64 => Values::F64(Vec::new()),
        }
    }
}

/// A number that stands in a file in either byte order.
pub(super) trait Stored: Pod {
    fn swapped(self) -> Self;
    fn double(self) -> f64;
}

macro_rules! stored {
    ($($type:ty),*) => { $(impl Stored for $type { fn swapped(self) -> Self { Self::from_ne_bytes({ let mut bytes = self.to_ne_bytes(); bytes.reverse(); bytes }) } fn double(self) -> f64 { self as f64 } })* };
}
stored!(i8, u8, i16, u16, i32, u32, i64, u64, f32, f64);

/// The number at an offset of a record; zero beyond its end.
#[inline]
pub(super) fn at<T: Stored>(record: &[u8], offset: usize, swap: bool) -> T {
    let number = record.get(offset..offset + size_of::<T>()).map_or(T::zeroed(), bytemuck::pod_read_unaligned);
    if swap { T::swapped(number) } else { number }
}

/// Calls for the number of a type at an offset of a record, as a value of its own type.
macro_rules! with_number {
    ($scalar:expr, $record:expr, $offset:expr, $swap:expr, $number:ident => $body:expr) => {
        match $scalar {
            Scalar::I8 => {
                let $number = $crate::io::values::at::<i8>($record, $offset, $swap);
                $body
            }
            Scalar::U8 => {
                let $number = $crate::io::values::at::<u8>($record, $offset, $swap);
                $body
            }
            Scalar::I16 => {
                let $number = $crate::io::values::at::<i16>($record, $offset, $swap);
                $body
            }
            Scalar::U16 => {
                let $number = $crate::io::values::at::<u16>($record, $offset, $swap);
                $body
            }
            Scalar::I32 => {
                let $number = $crate::io::values::at::<i32>($record, $offset, $swap);
                $body
            }
            Scalar::U32 => {
                let $number = $crate::io::values::at::<u32>($record, $offset, $swap);
                $body
            }
            Scalar::I64 => {
                let $number = $crate::io::values::at::<i64>($record, $offset, $swap);
                $body
            }
            Scalar::U64 => {
                let $number = $crate::io::values::at::<u64>($record, $offset, $swap);
                $body
            }
            Scalar::F32 => {
                let $number = $crate::io::values::at::<f32>($record, $offset, $swap);
                $body
            }
            Scalar::F64 => {
                let $number = $crate::io::values::at::<f64>($record, $offset, $swap);
                $body
            }
        }
    };
}
pub(super) use with_number;

impl Values {
    /// How many numbers.
    pub fn len(&self) -> usize {
        with_values!(self, vector => vector.len())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Name of the type, as numpy calls it.
    pub fn type_name(&self) -> &'static str {
        match self {
            Values::Bool(_) => "bool",
            Values::I8(_) => "int8",
            Values::U8(_) => "uint8",
            Values::I16(_) => "int16",
            Values::U16(_) => "uint16",
            Values::I32(_) => "int32",
            Values::U32(_) => "uint32",
            Values::I64(_) => "int64",
            Values::U64(_) => "uint64",
            Values::F32(_) => "float32",
            Values::F64(_) => "float64",
        }
    }

    /// One of the numbers as a double; nothing beyond the end.
    pub fn number(&self, index: usize) -> Option<f64> {
        match self {
            Values::Bool(vector) => vector.get(index).map(|&value| f64::from(u8::from(value))),
            Values::I8(vector) => vector.get(index).map(|&value| value.into()),
            Values::U8(vector) => vector.get(index).map(|&value| value.into()),
            Values::I16(vector) => vector.get(index).map(|&value| value.into()),
            Values::U16(vector) => vector.get(index).map(|&value| value.into()),
            Values::I32(vector) => vector.get(index).map(|&value| value.into()),
            Values::U32(vector) => vector.get(index).map(|&value| value.into()),
            Values::I64(vector) => vector.get(index).map(|&value| value as f64),
            Values::U64(vector) => vector.get(index).map(|&value| value as f64),
            Values::F32(vector) => vector.get(index).map(|&value| value.into()),
            Values::F64(vector) => vector.get(index).copied(),
        }
    }

    /// One of the numbers, if it is whole and not a float.
    pub(super) fn whole(&self, index: usize) -> Option<i128> {
        match self {
            Values::Bool(vector) => vector.get(index).map(|&value| value.into()),
            Values::I8(vector) => vector.get(index).map(|&value| value.into()),
            Values::U8(vector) => vector.get(index).map(|&value| value.into()),
            Values::I16(vector) => vector.get(index).map(|&value| value.into()),
            Values::U16(vector) => vector.get(index).map(|&value| value.into()),
            Values::I32(vector) => vector.get(index).map(|&value| value.into()),
            Values::U32(vector) => vector.get(index).map(|&value| value.into()),
            Values::I64(vector) => vector.get(index).map(|&value| value.into()),
            Values::U64(vector) => vector.get(index).map(|&value| value.into()),
            Values::F32(_) | Values::F64(_) => None,
        }
    }

    /// The rows of `columns` numbers that `rows` names.
    pub(super) fn rows(&self, rows: &[u32], columns: usize) -> Values {
        fn pick<T: Copy>(vector: &[T], rows: &[u32], columns: usize) -> Vec<T> {
            rows.iter().flat_map(|&row| vector[row as usize * columns..][..columns].iter().copied()).collect()
        }
        match self {
            Values::Bool(vector) => Values::Bool(pick(vector, rows, columns)),
            Values::I8(vector) => Values::I8(pick(vector, rows, columns)),
            Values::U8(vector) => Values::U8(pick(vector, rows, columns)),
            Values::I16(vector) => Values::I16(pick(vector, rows, columns)),
            Values::U16(vector) => Values::U16(pick(vector, rows, columns)),
            Values::I32(vector) => Values::I32(pick(vector, rows, columns)),
            Values::U32(vector) => Values::U32(pick(vector, rows, columns)),
            Values::I64(vector) => Values::I64(pick(vector, rows, columns)),
            Values::U64(vector) => Values::U64(pick(vector, rows, columns)),
            Values::F32(vector) => Values::F32(pick(vector, rows, columns)),
            Values::F64(vector) => Values::F64(pick(vector, rows, columns)),
        }
    }

    /// Columns of the same type side by side; nothing if their types or lengths differ.
    pub(super) fn side_by_side(columns: &[&Values]) -> Option<Values> {
        fn interleave<'a, T: Copy + 'a>(columns: &[&'a Values], inner: impl Fn(&'a Values) -> Option<&'a Vec<T>>) -> Option<Vec<T>> {
            let vectors: Vec<&Vec<T>> = columns.iter().map(|column| inner(column)).collect::<Option<_>>()?;
            let rows = vectors.first()?.len();
            if vectors.iter().any(|vector| vector.len() != rows) {
                return None;
            }
            Some((0..rows).flat_map(|row| vectors.iter().map(move |vector| vector[row])).collect())
        }
        macro_rules! arms {
            ($($variant:ident),*) => {
                match columns.first()? {
                    $(Values::$variant(_) => Values::$variant(interleave(columns, |column| match column { Values::$variant(vector) => Some(vector), _ => None })?),)*
                }
            };
        }
        Some(arms!(Bool, I8, U8, I16, U16, I32, U32, I64, U64, F32, F64))
    }

    /// The same numbers in the type that `name` names (see [`Values::type_name`]); nothing if one of them would change.
    pub(super) fn converted(&self, name: &str) -> Option<Values> {
        fn whole<T: TryFrom<i128>>(values: &Values) -> Option<Vec<T>> {
            (0..values.len())
                .map(|i| {
                    let number = match values {
                        Values::F32(_) | Values::F64(_) => {
                            let number = values.number(i)?;
                            (number == number.trunc() && number.abs() < 1e30).then_some(number as i128)?
                        }
                        _ => values.whole(i)?,
                    };
                    T::try_from(number).ok()
                })
                .collect()
        }
        if name == self.type_name() {
            return Some(self.clone());
        }
        Some(match name {
            "bool" => Values::Bool(whole::<u8>(self)?.into_iter().map(|value| (value <= 1).then_some(value == 1)).collect::<Option<_>>()?),
            "int8" => Values::I8(whole(self)?),
            "uint8" => Values::U8(whole(self)?),
            "int16" => Values::I16(whole(self)?),
            "uint16" => Values::U16(whole(self)?),
            "int32" => Values::I32(whole(self)?),
            "uint32" => Values::U32(whole(self)?),
            "int64" => Values::I64(whole(self)?),
            "uint64" => Values::U64(whole(self)?),
            "float32" => Values::F32(
                (0..self.len())
                    .map(|i| {
                        self.number(i).and_then(|number| (f64::from(number as f32) == number || number.is_nan()).then_some(number as f32))
                    })
                    .collect::<Option<_>>()?,
            ),
            "float64" => Values::F64((0..self.len()).map(|i| self.number(i)).collect::<Option<_>>()?),
            _ => return None,
        })
    }
}

/// Numbers of each vertex under a name: colours, normals, labels, whatever a file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// What the numbers are called.
    pub name: String,
    /// How many numbers a vertex has.
    pub columns: usize,
    /// Whether this is a table: one of a single column differs from a vector.
    pub table: bool,
    /// The numbers, vertex after vertex.
    pub values: Values,
}

impl Field {
    pub(super) fn vector(name: impl Into<String>, values: Values) -> Self {
        Field { name: name.into(), columns: 1, table: false, values }
    }

    pub(super) fn table(name: impl Into<String>, columns: usize, values: Values) -> Self {
        Field { name: name.into(), columns, table: true, values }
    }
}
