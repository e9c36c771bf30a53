// File formats of the examples: images as PPM (P6), depths as NumPy arrays (.npy) of float32.

#ifndef FILES_H
#define FILES_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

// Prints what is wrong with a file, and exits.
static inline void file_error(const char *path, const char *what) {
    fprintf(stderr, "%s: %s\n", path, what);
    exit(EXIT_FAILURE);
}

static inline void *allocated(const char *path, size_t bytes) {
    void *memory = malloc(bytes);
    if (memory == NULL) file_error(path, "not enough memory");
    return memory;
}

// Reads red, green and blue of every pixel, row by row.
static inline uint8_t *read_ppm(const char *path, size_t *width, size_t *height) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) file_error(path, "cannot be opened");
    if (fscanf(file, "P6 %zu %zu 255", width, height) != 2 || fgetc(file) == EOF) {
        file_error(path, "is not an 8-bit PPM");
    }
    if (*width == 0 || *height == 0 || *width > 1 << 15 || *height > 1 << 15) {
        file_error(path, "has an implausible size");
    }
    size_t bytes = 3 * *width * *height;
    uint8_t *rgb = (uint8_t *)allocated(path, bytes);
    if (fread(rgb, 1, bytes, file) != bytes) file_error(path, "is too short");
    fclose(file);
    return rgb;
}

// Reads a map of `width * height` floats, row by row.
static inline float *read_npy(const char *path, size_t width, size_t height) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) file_error(path, "cannot be opened");
    unsigned char start[10];
    if (fread(start, 1, 10, file) != 10 || memcmp(start, "\x93NUMPY\1\0", 8) != 0) {
        file_error(path, "is not a NumPy array of version 1");
    }
    size_t length = start[8] + 256u * start[9];
    char *header = (char *)allocated(path, length + 1);
    if (fread(header, 1, length, file) != length) file_error(path, "is too short");
    header[length] = '\0';
    const char *shape = strstr(header, "'shape': (");
    size_t rows = 0, columns = 0;
    int known = shape != NULL && sscanf(shape, "'shape': (%zu, %zu", &rows, &columns) == 2;
    known &= strstr(header, "'<f4'") != NULL && strstr(header, "'fortran_order': False") != NULL;
    if (!known || rows != height || columns != width) {
        file_error(path, "does not hold float32 values of the image's size");
    }
    free(header);
    float *values = (float *)allocated(path, width * height * sizeof *values);
    if (fread(values, sizeof *values, width * height, file) != width * height) {
        file_error(path, "is too short");
    }
    fclose(file);
    return values;
}

static inline void write_npy(const char *path, const float *values, size_t width, size_t height) {
    char dict[118], header[128];
    snprintf(dict, sizeof dict, "{'descr': '<f4', 'fortran_order': False, 'shape': (%zu, %zu), }",
             height, width);
    // The values start at a multiple of 64 bytes.
    snprintf(header, sizeof header, "%-117s\n", dict);
    FILE *file = fopen(path, "wb");
    if (file == NULL) file_error(path, "cannot be written");
    size_t whole = fwrite("\x93NUMPY\1\0\x76\0", 1, 10, file) == 10;
    whole &= fwrite(header, 1, 118, file) == 118;
    whole &= fwrite(values, sizeof *values, width * height, file) == width * height;
    if (fclose(file) != 0 || !whole) file_error(path, "cannot be written");
}

#ifdef __cplusplus
}
#endif

#endif
