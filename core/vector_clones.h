// Marks a function with hot loops to be compiled for AVX2 as well as for the baseline, chosen when the
// program is loaded. Without fused multiply-add, so that both give the same bits.
#pragma once

// A sanitizer's runtime is not ready when the loader asks which clone to take.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define BRICKYARD_VECTOR_CLONES
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) || __has_feature(memory_sanitizer)
#define BRICKYARD_VECTOR_CLONES
#endif
#endif

#if !defined(BRICKYARD_VECTOR_CLONES)
#if defined(__x86_64__) && defined(__linux__) && defined(__GLIBC__)
#define BRICKYARD_VECTOR_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define BRICKYARD_VECTOR_CLONES
#endif
#endif
