#include "blake2s.hpp"

#include <string.h>

#include "bytes.hpp"

namespace fss {
namespace {

constexpr size_t kBlock = 64;

constexpr uint32_t kStart[8] = {0x6A09E667, 0xBB67AE85, 0x3C6EF372, 0xA54FF53A,
                                0x510E527F, 0x9B05688C, 0x1F83D9AB, 0x5BE0CD19};

constexpr uint8_t kOrder[10][16] = {
    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15},
    {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
    {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4},
    {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
    {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13},
    {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
    {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11},
    {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
    {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5},
    {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0}};

// Columns, then diagonals.
constexpr uint8_t kMixed[8][4] = {{0, 4, 8, 12}, {1, 5, 9, 13}, {2, 6, 10, 14}, {3, 7, 11, 15},
                                  {0, 5, 10, 15}, {1, 6, 11, 12}, {2, 7, 8, 13}, {3, 4, 9, 14}};

uint32_t rotate(uint32_t x, int by) { return x >> by | x << (32 - by); }

void mix(uint32_t& a, uint32_t& b, uint32_t& c, uint32_t& d, uint32_t x, uint32_t y) {
  a += b + x;
  d = rotate(d ^ a, 16);
  c += d;
  b = rotate(b ^ c, 12);
  a += b + y;
  d = rotate(d ^ a, 8);
  c += d;
  b = rotate(b ^ c, 7);
}

void compress(uint32_t* h, const uint8_t* block, uint32_t bytes_so_far, bool last) {
  uint32_t m[16], v[16];
  for (int i = 0; i < 16; ++i) m[i] = load<uint32_t>(block + 4 * i);
  memcpy(v, h, 32);
  memcpy(v + 8, kStart, 32);
  v[12] ^= bytes_so_far;
  if (last) v[14] = ~v[14];
  for (const auto& order : kOrder) {
    for (int i = 0; i < 8; ++i) {
      const auto& k = kMixed[i];
      mix(v[k[0]], v[k[1]], v[k[2]], v[k[3]], m[order[2 * i]], m[order[2 * i + 1]]);
    }
  }
  for (int i = 0; i < 8; ++i) h[i] ^= v[i] ^ v[i + 8];
}

}  // namespace

void blake2s(const Key& key, const uint8_t* data, size_t size, uint8_t* digest,
             uint8_t digest_size) {
  uint32_t h[8];
  memcpy(h, kStart, 32);
  h[0] ^= 0x01010000u ^ static_cast<uint32_t>(key.size) << 8 ^ digest_size;
  uint8_t block[kBlock] = {};
  uint32_t done = 0;
  if (key.size) {  // the key, padded, is the first block
    memcpy(block, key.bytes, key.size);
    done = kBlock;
    compress(h, block, done, size == 0);
  }
  while (size > 0 || done == 0) {
    const size_t part = size < kBlock ? size : kBlock;
    memset(block, 0, kBlock);
    if (part) memcpy(block, data, part);
    data += part;
    size -= part;
    done += static_cast<uint32_t>(part);
    compress(h, block, done, size == 0);
    if (part == 0) break;  // the empty message
  }
  uint8_t all[32];
  for (int i = 0; i < 8; ++i) store(all + 4 * i, h[i]);
  memcpy(digest, all, digest_size);
}

}  // namespace fss
