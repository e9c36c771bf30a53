// Completes depth from an image and sparse depths, in C++ without other libraries.
//
//     complete IMAGE.ppm SPARSE.npy DEPTH.npy

#include "files.h"
#include <iostream>
#include <lsdc.hpp>

template <class T>
using Values = std::unique_ptr<T, decltype(&std::free)>;

int main(int count, char **arguments) try {
    if (count != 4) {
        std::cerr << "usage: " << arguments[0] << " IMAGE.ppm SPARSE.npy DEPTH.npy\n";
        return EXIT_FAILURE;
    }
    std::size_t rows, cols;
    Values<std::uint8_t> pixels(read_ppm(arguments[1], &cols, &rows), &std::free);
    Values<float> sparse(read_npy(arguments[2], cols, rows), &std::free);

    // A view of an image: the first pixel, rows, columns, the order of colours and, if rows have gaps, bytes from one row to
    // the next.
    lsdc::Image image(pixels.get(), rows, cols, lsdc::Format::rgb8);
    lsdc::Completer completer;
    lsdc::Scene scene = completer.scene(image);

    // A map of depths: a view of floats, 0 at pixels without a measurement. For a list of points, use
    // std::vector<lsdc::Point>; 16-bit integers need their unit: lsdc::Depths(View<const std::uint16_t>(...), 0.001).
    lsdc::View<const float> depths(sparse.get(), rows, cols);
    lsdc::Completion completion = scene.complete(depths);

    // Results go into your own memory, or into a new lsdc::Map.
    std::vector<float> depth(rows * cols);
    completion.depth(lsdc::View<float>(depth.data(), rows, cols));
    lsdc::Map deviation = completion.standard_deviation();
    write_npy(arguments[3], depth.data(), cols, rows);
    std::cout << completion.report().used << " points, " << depth[rows / 2 * cols + cols / 2] << " +- "
              << deviation.at(rows / 2, cols / 2) << " m in the middle\n";
    return EXIT_SUCCESS;
} catch (const lsdc::Error &error) {
    std::cerr << "lsdc: " << error.what() << "\nhint: " << error.hint() << '\n';
    return EXIT_FAILURE;
}
