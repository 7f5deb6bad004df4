//! Order-preserving readers and writers of surfaces and clouds.
