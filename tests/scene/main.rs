//! Scene import, against what the glTF specification says of files made here, and against files of others.

mod builder;
mod shared;
